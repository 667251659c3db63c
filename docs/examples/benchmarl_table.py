"""What multi-agent algorithms reach beside F-DRL: ``benchmarl_table.py runs/benchmarl [FDRL]``.

Reads ``evaluations.csv`` in every folder of a sweep, named ALGORITHM-SEED, and of a sweep of F-DRL,
named by its seed, and prints the means of each run's last evaluations as a table.
"""

from __future__ import annotations

import csv
import sys
from collections import defaultdict
from pathlib import Path
from statistics import fmean

LAST = 5
"""Evaluations of a run that its measures are the mean of."""
REACHED = 0.9
"""What success must be three times in a row for a run to have converged."""

Rows = list[dict[str, float]]


def evaluations(path: Path, epsilon: float) -> Rows:
    """A run's evaluations with an epsilon, in their order."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    return [row for row in rows if row["epsilon"] == epsilon]


def last(rows: Rows, name: str) -> float:
    """The mean of a measure over the last evaluations."""
    return fmean(row[name] for row in rows[-LAST:])


def converged(rows: Rows) -> str:
    """The tick of the first of three evaluations in a row with enough success."""
    good = [row["success"] >= REACHED for row in rows]
    for at in range(len(rows) - 2):
        if all(good[at : at + 3]):
            return f"{rows[at]['tick']:.0f}"
    return "never"


def line(name: str, paths: list[Path]) -> str:
    """A row of the table, of an algorithm's runs."""
    random, greedy = ([evaluations(path, e) for path in paths] for e in (0.05, 0.0))
    success = [last(rows, "success") for rows in random]
    cells = [
        name,
        " ".join(f"{value:.2f}" for value in success),
        f"{fmean(success):.2f}",
        f"{min(success):.2f}",
        f"{fmean(last(rows, 'success') for rows in greedy):.2f}",
        " ".join(f"{last(rows, 'ee'):.3f}" for rows in random),
        f"{fmean(last(rows, 'ee') for rows in random):.3f}",
        " ".join(converged(rows) for rows in random),
    ]
    return f"| {' | '.join(cells)} |"


def table(sweep: Path, *federated: Path) -> str:
    """The table of a sweep of BenchMARL's, and of sweeps of F-DRL's under their folders' names."""
    runs: dict[str, list[Path]] = defaultdict(list)
    for path in sorted(sweep.glob("*-*/evaluations.csv")):
        runs[path.parent.name.rpartition("-")[0].upper()].append(path)
    for folder in federated:
        runs[folder.name] = sorted(folder.glob("*/evaluations.csv"))
    begun = {
        name: [path for path in paths if evaluations(path, 0.0)] for name, paths in runs.items()
    }
    columns = ("algorithm", "success by seed", "mean", "worst", "greedy", "EE by seed", "mean",
               "converged, ticks")  # fmt: skip
    lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    return "\n".join([*lines, *(line(name, paths) for name, paths in begun.items() if paths)])


if __name__ == "__main__":
    if len(sys.argv) < 2 or not all(Path(name).is_dir() for name in sys.argv[1:]):
        sys.exit(
            f"folders={sys.argv[1:]}: allowed is a folder of BenchMARL's runs, then of F-DRL's"
        )
    print(table(*map(Path, sys.argv[1:])))
