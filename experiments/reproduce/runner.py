"""The runs that the cells of some targets need, trained where they are missing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from conf import Config
from experiments.batch import train as batch
from experiments.batch.launcher import build_launcher
from experiments.batch.states import folder_of
from experiments.reproduce.results.runs import Run, Runs
from experiments.reproduce.targets.plan import Cell, configs
from experiments.runtimes.folders import folder_lock


class Plan:
    """The cells of some targets, whose names may come twice, with their runs in a call's folder.

    Raises:
        ConfigError: a wrong key, value or combination.
    """

    def __init__(self, cells: Sequence[Cell], out: Path) -> None:
        self.store = out.absolute() / "runs"
        self.cells = [(cell, configs(cell, self.store)) for cell in cells]

    @property
    def configs(self) -> dict[Path, Config]:
        """Every run once, by its folder."""
        return {folder_of(c): c for _, runs in self.cells for c in runs.values()}

    def runs(self, cells: Sequence[Cell]) -> Runs:
        """The runs of some of the cells, by the cell's name and by seed."""
        return {
            cell.name: {seed: Run(folder_of(config)) for seed, config in runs.items()}
            for cell, runs in self.cells
            if cell in cells
        }


def train(
    plan: Plan, workers: int | None, hydra: Sequence[str], console: Console
) -> batch.BatchOutcome:
    """Trains every run of a plan that is not done.

    ``workers`` are processes at once, as many as cores if None, and ``hydra`` overrides of Hydra's
    launcher.

    Raises:
        ConfigError: the launcher is wrong, or another call is training in this folder.
    """
    build_launcher(print, hydra, plan.store, 1)  # before anything is made
    plan.store.mkdir(parents=True, exist_ok=True)
    busy = "--out", plan.store.parent, "a folder in which nothing is being reproduced"
    with folder_lock(plan.store, busy):
        runs = list(plan.configs.values())
        return batch.train(runs, plan.store, console, hydra, workers, empties=True)
