"""How many clients Flower's simulation engine runs at once on this machine."""

from __future__ import annotations

import os


def max_concurrent_clients() -> int:
    """Clients that Flower's simulation engine runs at once on this machine.

    It uses a bare ``ThreadPoolExecutor``, which has min(32, cores + 4) workers. Robots in
    lockstep wait for each other, so one client more would never start.
    """
    return min(32, _cores() + 4)


def default_concurrency() -> int:
    """Clients that Flower's simulation engine runs at once if it is told nothing else.

    It gives each client two cores. A run of ours that starts its own SuperLink asks for one core a
    client and as many cores as clients instead.
    """
    return max(1, _cores() // 2)


def _cores() -> int:
    return getattr(os, "process_cpu_count", os.cpu_count)() or 1
