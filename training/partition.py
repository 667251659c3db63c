"""How robots are dealt to clients."""

from __future__ import annotations

import numpy as np

Block = tuple[int, ...]
"""The robots of one client."""


def partition_robots(robots: int, clients: int) -> list[Block]:
    """Deals robots to clients in blocks of neighbours, as even as can be.

    Args:
        robots: K.
        clients: 1 to K.

    Returns:
        The robots of each client.
    """
    parts = np.array_split(np.arange(robots), clients)
    return [tuple(int(robot) for robot in part) for part in parts]
