"""The first episodes of a few runs, kept beside the results so that they can be run again.

With equal configuration and seed, a run that is cut short has the same first episodes as the whole
one, to the bit on one type of processor and one version of torch and NumPy.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.reproduce.results.output import Row
from experiments.reproduce.results.runs import Run
from experiments.reproduce.results.statistics import Floats
from experiments.reproduce.targets.plan import COMMON
from experiments.runtimes import local
from storage.atomic import write_atomically
from training.preflight import checked_training
from training.run_folder import RunFolder

FILE = "check.csv"
TICKS = 1000
"""Of a run, whose episodes up to there are kept: forty aggregations, all agents learning."""

COLUMNS = ("target", "cell", "seed", "overrides", "computed_by", "episode", "tick", "reward")


@dataclass(frozen=True)
class RegressionRun:
    """The first episodes of a run.

    Attributes:
        target: whose run it is, such as fig3; its ``cell``, with ``overrides``, and ``seed``.
        computed_by: versions and type of processor.
        ticks: at which the episodes end, shape (episodes,).
        rewards: their total rewards, shape (episodes,).
    """

    target: str
    cell: str
    seed: int
    overrides: tuple[str, ...]
    computed_by: str
    ticks: Floats
    rewards: Floats


def computed_by(fingerprint: str) -> str:
    """A fingerprint without our own packages: what may change bits though the program does not."""
    return fingerprint.split("), ", 1)[1]


def rows_of(target: str, cell: str, overrides: Sequence[str], run: Run) -> list[Row]:
    """The lines to be kept of a run, by ``COLUMNS``."""
    metrics, by = run.metrics(), computed_by(run.summary["fingerprint"])
    of = target, cell, run.seed, " ".join(overrides), by
    return [
        (*of, int(episode), int(tick), repr(float(reward)))
        for episode, tick, reward in zip(
            metrics["episode"], metrics["tick"], metrics["reward"], strict=True
        )
        if tick <= TICKS
    ]


def write(folder: Path, rows: Sequence[Row]) -> Path:
    """Writes the file."""
    lines = [",".join(f'"{value}"' for value in row) for row in (COLUMNS, *rows)]
    write_atomically(folder / FILE, "\n".join(lines) + "\n")
    return folder / FILE


def read(folder: Path) -> list[RegressionRun]:
    """What the file of a folder keeps, a run each."""
    groups: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    with (folder / FILE).open(encoding="utf-8-sig", newline="") as file:
        for row in csv.DictReader(file):
            groups.setdefault(tuple(row[name] for name in COLUMNS[:5]), []).append(row)
    found = []
    for (target, cell, seed, overrides, by), rows in groups.items():
        ticks, rewards = (np.array([float(row[n]) for row in rows]) for n in ("tick", "reward"))
        of = target, cell, int(seed), tuple(overrides.split()), by
        found.append(RegressionRun(*of, ticks, rewards))
    return found


def rerun(kept: RegressionRun, folder: Path) -> Run:
    """Trains the first ticks of a run again, in a new folder."""
    short = (f"train.max_ticks={TICKS}", "evaluation.episodes=1")
    own = (f"seed={kept.seed}", f"run.dir={folder}")
    config = checked_training([*COMMON, *kept.overrides, *short, *own])
    local.train(config, RunFolder(folder))
    return Run(folder)
