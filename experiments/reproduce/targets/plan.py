"""What a target of ``risfleet reproduce`` trains: cells, the seeds of each, and where runs lie."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from conf import Config, fingerprint, to_yaml
from experiments.reproduce.results.runs import Runs
from training.preflight import checked_training

TARGETS = (
    "fig3",
    "fig4",
    "fig5",
    "ablations",
    "claims",
    "optimality",
    "building",
    "privacy",
    "bytes",
    "airtime",
    "heterogeneity",
    "gossip",
    "losses",
    "attacks",
)
"""Each a module beside this one, with its ``TARGET``."""


COMMON = ("runtime=local", "run.figures=false", "run.tensorboard=false")
"""Of every run: one process, and no pictures of its own."""

SEEDS = (10, 11, 12, 13, 14)
"""The seeds that are reported: no setting was chosen on them (docs/reproduction.md)."""

THREE_SEEDS = SEEDS[:3]
QUICK_SEEDS = SEEDS[:2]

FRESH_SEEDS = (40, 41, 42, 43, 44)
"""Of what is reported of ``experiment=best``, which was tuned on 0 and 1: each is run once."""


@dataclass(frozen=True)
class Cell:
    """One configuration, and the seeds to train it with.

    Attributes:
        name: unique within a target.
        overrides: Hydra's, without ``seed``, ``runtime`` and ``run``.
        seeds: of its runs.
    """

    name: str
    overrides: tuple[str, ...]
    seeds: tuple[int, ...]


class Target(Protocol):
    """A figure or table: the runs that it needs, and what it makes of them."""

    @property
    def name(self) -> str:
        """As on the command line."""

    def cells(self, quick: bool) -> list[Cell]:
        """What must have been trained.

        Args:
            quick: minutes on two cores: fewer seeds, fewer points, shorter runs.
        """

    def report(self, runs: Runs, out: Path, *, quick: bool) -> list[Path]:
        """Writes figure, data and tables, which say if they are quick ones; returns the files.

        Args:
            runs: every run of ``cells``, by the cell's name and by seed.
            out: an existing folder, whose ``planned.csv`` keeps planned values.
            quick: as in ``cells``.
        """


def with_overrides(cells: Sequence[Cell], overrides: Sequence[str]) -> list[Cell]:
    """Cells with the user's overrides on top of their own."""
    return [dataclasses.replace(cell, overrides=(*cell.overrides, *overrides)) for cell in cells]


def configs(cell: Cell, store: Path) -> dict[int, Config]:
    """The checked configuration of each run of a cell, by seed, with its folder in ``store``.

    Cells of equal configurations share their runs.

    Raises:
        ConfigError: a wrong key, value or combination.
    """
    base = checked_training([*COMMON, *cell.overrides])
    folder = store / cell_folder(base)
    found = {}
    for seed in cell.seeds:
        run = dataclasses.replace(base.run, dir=str(folder / f"seed={seed}"))
        found[seed] = dataclasses.replace(base, seed=seed, run=run)
    return found


def cell_folder(config: Config) -> str:
    """The name of a cell's folder: what its runs compute, with this version of the program.

    So a changed program trains anew, and what an earlier version trained stays where it is.
    """
    plain = dataclasses.replace(
        config, seed=0, run=dataclasses.replace(config.run, dir=None, id=None)
    )
    text = f"{fingerprint(config.env)}\n{to_yaml(plain)}"
    return f"k{config.env.robots}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"
