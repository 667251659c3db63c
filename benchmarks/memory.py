"""What each process of a deployment takes: memory, and processor time while it trains."""

from __future__ import annotations

import os
import tempfile
import time
import uuid
from collections import defaultdict
from pathlib import Path

import numpy as np

from benchmarks.result import Result
from benchmarks.runs import USUAL, train

MARK = "RISFLEET_BENCHMARK"
PROC = Path("/proc")
TICK_S = 1 / os.sysconf("SC_CLK_TCK")
SCALE_MB = 1 / 1024
ROLES = {
    "flwr-clientapp": "client_app",
    "flwr-serverapp": "server_app",
    "flower-supernode": "supernode",
    "flower-superlink": "superlink",
    "experiments.cli": "launcher",
}
EXECUTOR = "flower-superexec"
HOW = (
    "MB of a process of this role in a deployment with 3 robots, the largest of samples a second"
    " apart; proportional set size: shared pages count by halves, thirds and so on"
)
CPU_HOW = "processors that all processes of this role keep busy while the run trains, 1 is one core"

Sample = dict[int, tuple[str, float, float, float]]
"""Role, resident and proportional set size in MB, processor time in s of each process."""


class MemoryWatch:
    """Looks at all processes that have a mark in their environment.

    Args:
        mark: the value of the variable `MARK`.
    """

    def __init__(self, mark: str) -> None:
        self._mark = f"{MARK}={mark}".encode()
        self.samples: list[tuple[float, Sample]] = []

    def __call__(self) -> None:
        """Takes a sample."""
        found: Sample = {}
        for entry in PROC.iterdir():
            if entry.name.isdigit():
                try:
                    if self._mark in (entry / "environ").read_bytes().split(b"\0"):
                        found[int(entry.name)] = _measured(entry)
                except OSError:
                    continue  # it has ended
        self.samples.append((time.monotonic(), found))


def memory(*, quick: bool = False) -> list[Result]:
    """Measures ``memory_*_mb`` and ``busy_*`` of each role."""
    mark = uuid.uuid4().hex
    watch = MemoryWatch(mark)
    with tempfile.TemporaryDirectory(prefix="risfleet-bench-") as folder:
        ticks = 500 if quick else 3000
        train("deployment", USUAL, ticks, Path(folder) / "run", {MARK: mark}, watch)
    return [*_sizes(watch.samples), *_busy(watch.samples)]


def _measured(process: Path) -> tuple[str, float, float, float]:
    """A process's role, sizes and processor time.

    Raises:
        OSError: it has ended.
    """
    sizes: dict[str, float] = {}
    for line in (process / "smaps_rollup").read_text().splitlines()[1:]:
        name, value, *_ = line.split()
        sizes[name] = float(value) * SCALE_MB
    fields = (process / "stat").read_text().rpartition(")")[2].split()
    return _role(process), sizes["Rss:"], sizes["Pss:"], TICK_S * sum(map(int, fields[11:13]))


def _role(process: Path) -> str:
    """What a process is to Flower, by its command; a SuperExec's parent says whose it is."""
    command = (process / "cmdline").read_bytes().decode(errors="replace")
    if EXECUTOR in command:
        parent = (process / "stat").read_text().rpartition(")")[2].split()[1]
        return f"{_role(PROC / parent)}_superexec"
    return next((role for word, role in ROLES.items() if word in command), "")


def _sizes(samples: list[tuple[float, Sample]]) -> list[Result]:
    """Each role's memory: the largest of every process, and the range over its processes."""
    largest: dict[str, dict[int, tuple[float, float]]] = defaultdict(dict)
    for _, sample in samples:
        for pid, (role, resident, proportional, _) in sample.items():
            if not role:
                continue  # a command that hands the run in, say
            before = largest[role].get(pid, (0.0, 0.0))
            largest[role][pid] = max(before[0], resident), max(before[1], proportional)
    results = []
    for role, processes in sorted(largest.items()):
        resident, proportional = np.array(list(processes.values())).T
        details = {"resident_mb": float(np.median(resident)), "processes": float(len(processes))}
        results.append(Result.over(f"memory_{role}_mb", proportional, "MB", HOW, None, details))
    return results


def _busy(samples: list[tuple[float, Sample]]) -> list[Result]:
    """Each role's processor time between samples in which clients were there."""
    training = [s for s in samples if any(p[0] == "client_app" for p in s[1].values())][2:-1]
    if len(training) < 2:
        return []
    (began, first), (ended, last) = training[0], training[-1]
    spent: dict[str, float] = defaultdict(float)
    for pid, (role, _, _, cpu_s) in last.items():
        if role and pid in first:
            spent[role] += cpu_s - first[pid][3]
    return [
        Result.over(f"busy_{role}", np.array([seconds / (ended - began)]), "cores", CPU_HOW)
        for role, seconds in sorted(spent.items())
    ]
