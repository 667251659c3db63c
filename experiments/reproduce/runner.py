"""Trains what the cells of a target still miss, with every core, and goes on where it stopped."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from conf import Config
from experiments.display import read_progress
from experiments.folders import held
from experiments.mishaps import in_words
from experiments.reproduce.jobs import Job, State, dealt, folder_of, missing, state_of
from experiments.reproduce.launch import build_launcher
from experiments.reproduce.plan import Cell, configs
from experiments.reproduce.runs import Run, Runs
from experiments.reproduce.watch import Interrupts, Watch
from experiments.reproduce.worker import Work

ATTEMPTS = 2
"""A process that dies takes its launcher's other jobs with it, so these are launched again."""


@dataclass(frozen=True)
class Outcome:
    """What became of all runs.

    Attributes:
        done: folders of the runs that are there.
        failed: why the others are not, by folder; empty after Ctrl-C.
        interrupted: whether Ctrl-C ended them early.
    """

    done: tuple[Path, ...]
    failed: Mapping[Path, str]
    interrupted: bool


class Plan:
    """The cells of some targets with their runs, checked.

    Args:
        cells: of all targets; names may come twice.
        out: the folder of the call.

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

    def states(self) -> dict[Path, State]:
        """What each run's folder holds now."""
        return {folder: state_of(config) for folder, config in self.configs.items()}

    def runs(self, cells: Sequence[Cell]) -> Runs:
        """The runs of some of the cells, by the cell's name and by seed."""
        return {
            cell.name: {seed: Run(folder_of(config)) for seed, config in runs.items()}
            for cell, runs in self.cells
            if cell in cells
        }


def train(plan: Plan, workers: int, hydra: Sequence[str], console: Console) -> Outcome:
    """Trains every run of a plan that is not done.

    Args:
        plan: the runs.
        workers: processes at once.
        hydra: overrides of Hydra's own keys, such as its launcher.
        console: where to show progress.

    Raises:
        ConfigError: the launcher is wrong, or another call is training in this folder.
    """
    build_launcher(print, hydra, plan.store, workers)  # before anything starts
    plan.store.mkdir(parents=True, exist_ok=True)
    folders = list(plan.configs)
    with alone(plan.store), Interrupts(plan.store, folders, console) as interrupts:
        failed: dict[Path, str] = {}
        states = plan.states()
        for _ in range(ATTEMPTS):
            jobs = dealt(missing(plan.cells, states), workers)
            jobs = [job for job in jobs if not set(job.folders) <= set(failed)]
            if not jobs or interrupts.asked:
                break
            _clear(jobs, states)
            _launch(jobs, states, plan.store, workers, hydra, interrupts, console)
            states = plan.states()
            failed = _failed(states)
    done = tuple(folder for folder, state in states.items() if state is State.DONE)
    if interrupts.asked:
        return Outcome(done, {}, interrupted=True)
    lost = {folder: "it did not end" for folder in folders if folder not in done}
    return Outcome(done, lost | failed, interrupted=False)


def _clear(jobs: Sequence[Job], states: Mapping[Path, State]) -> None:
    """Removes what cannot be used, and what earlier attempts said of their end."""
    for folder in (folder for job in jobs for folder in job.folders):
        if states[folder] is State.NEW and folder.exists():
            shutil.rmtree(folder)
        elif _said_failed(folder):
            (folder / "progress.json").unlink()


def _failed(states: Mapping[Path, State]) -> dict[Path, str]:
    """Why runs failed that say so, by folder."""
    found = {}
    for folder, state in states.items():
        said = _said_failed(folder)
        if state is not State.DONE and said:
            found[folder] = said
    return found


def _said_failed(folder: Path) -> str | None:
    status = read_progress(folder)
    return str(status["message"]) if status and status["state"] == "failed" else None


def _launch(
    jobs: Sequence[Job],
    states: Mapping[Path, State],
    store: Path,
    workers: int,
    hydra: Sequence[str],
    interrupts: Interrupts,
    console: Console,
) -> None:
    """Hands jobs to Hydra's launcher and waits until all have ended."""
    left = [config for job in jobs for config in job.configs]
    done = sum(state is State.DONE for state in states.values())
    console.print(
        f"{len(left)} runs to train in {len(jobs)} jobs, {done} done before; {store}",
        highlight=False,
        soft_wrap=True,
    )
    launcher = build_launcher(Work(tuple(jobs), os.getpid()), hydra, store, workers)
    combinations = [[*job.overrides, f"seed={job.configs[0].seed}"] for job in jobs]
    with Watch(done, left, interrupts, console):
        try:
            launcher.launch(combinations, initial_job_idx=0)
        except Exception as error:  # a launcher's own: its processes were killed, its cluster left
            console.print(f"risfleet: {type(error).__name__}: {in_words(error)}".splitlines()[0])


def alone(store: Path) -> AbstractContextManager[None]:
    """Holds the folder of all runs.

    Raises:
        ConfigError: another process holds it.
    """
    return held(store, ("--out", store.parent, "a folder in which nothing is being reproduced"))
