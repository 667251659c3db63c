"""A sweep whose values one of Hydra's sweepers chooses, each from what earlier runs reached."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable, Sequence
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Override
from hydra.core.plugins import Plugins
from hydra.plugins.sweeper import Sweeper
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from conf import ConfigError
from conf.overrides import is_hydras, lines
from conf.own_groups import folders_of, override_of
from experiments.batch.launcher import build_plugin
from experiments.batch.sweeps import DIR, HYDRAS, holds_runs_alone
from experiments.console import PLAIN
from experiments.runtimes.folders import dated, made, run_lock
from experiments.runtimes.runner import ERRORS, print_error, train_missing
from training.preflight import checked_training
from training.run_folder import RunFolder

MEASURES = ("success", "ee", "ee_bits_per_joule", "sum_rate", "min_rate", "path_ratio")
PARTS = ("greedy", "eps05", "last5", "last5_greedy")
OBJECTIVE = "greedy.ee"

FOUND = "optimization_results.yaml"
"""What sweepers leave in a sweep's folder beside ``HYDRAS``."""

Trial = Callable[[int, Sequence[str]], float]
"""Trains the run of a number with what was chosen for it; gives what it reached."""


def check_objective(text: str) -> str:
    """The measure that ``--objective`` names.

    Raises:
        ConfigError: there is none of that name.
    """
    part, _, measure = text.rpartition(".")
    if measure not in MEASURES or part not in ("", *PARTS):
        allowed = f"one of {', '.join(MEASURES)}, with one of {', '.join(PARTS)} and a dot before"
        raise ConfigError(f"--objective {text}: allowed is {allowed} it.")
    return f"{part or 'greedy'}.{measure}"


def reached(folder: RunFolder, objective: str) -> float:
    """What a run that has ended has reached of an objective.

    Raises:
        ConfigError: it says nothing of it.
    """
    part, measure = objective.split(".")
    try:
        return float(folder.read_summary()["evaluation"][part][measure])
    except (KeyError, TypeError) as error:
        raise ConfigError(f"--objective {objective}: {folder} has no such measure.") from error


def build_sweeper(trial: Trial, hydra: Sequence[str], place: Path) -> Sweeper:
    """The sweeper that Hydra overrides name; it maximises, one run after the other.

    Arguments and errors are those of ``build_launcher``.
    """
    # With a seed the same command chooses the same values anew, and finds their runs done.
    ours = ["direction=maximize", "n_jobs=1"]
    ours += [] if "hydra/sweeper/sampler=grid" in hydra else ["sampler.seed=0"]
    ours = [f"hydra.sweeper.{item}" for item in ours if "hydra/sweeper=optuna" in hydra]

    def task(node: DictConfig) -> float:
        job = HydraConfig.get()
        return trial(int(job.job.num), list(job.overrides.task))

    sweeper = build_plugin(Plugins.instance().instantiate_sweeper, task, [*ours, *hydra], place)
    logging.getLogger("optuna").setLevel(logging.WARNING)
    return sweeper


class SearchEnded(BaseException):  # no error: Hydra would print one
    """A run, and with it the search, ended early with an exit status."""

    def __init__(self, status: int) -> None:
        super().__init__(f"ended with status {status}")
        self.status = status


def search(overrides: Sequence[Override], folder: Path | None, objective: str) -> int:
    """Trains run after run in a sweep's folder, each with what the sweeper chooses.

    Args:
        overrides: parsed, of the runs and of Hydra, without ``run.dir``; the sweeper chooses from
            those that list several values or give a range.
        folder: the sweep's, where runs that have ended are left as they are; a new one if None.
        objective: see ``check_objective``.

    Returns:
        The exit status: 0, that of the signal that ended a run early, or of a run that failed.

    Raises:
        ConfigError: a mistake, before any run begins.
    """
    objective = check_objective(objective)
    hydra = lines([item for item in overrides if is_hydras(item)])
    if any(item.startswith("hydra/launcher=") for item in hydra):
        raise ConfigError("hydra/launcher: allowed is none with hydra/sweeper: runs go in turn.")
    runs = [item for item in overrides if not is_hydras(item)]
    chosen = lines([item for item in runs if item.is_sweep_override()])
    fixed = lines([item for item in runs if not item.is_sweep_override()])
    if not chosen:
        say = "values to choose from, as in agent.learning_rate=interval(0.001,0.01)"
        raise ConfigError(f"hydra/sweeper: allowed with {say}.")
    checked_training(fixed)
    if own := folders_of(runs):
        hydra = [override_of(own), *hydra]
    build_sweeper(lambda number, values: 0.0, hydra, Path())  # a mistake leaves no folder behind
    if folder is not None and not holds_runs_alone(folder, {HYDRAS, FOUND}):
        raise ConfigError.of([(DIR, folder, "a folder that is new or empty, or of a sweep")])
    folder = made(folder or dated(Path("multirun")))
    console = Console()
    console.print(f"sweep folder: {folder}", **PLAIN)

    def trial(number: int, values: Sequence[str]) -> float:
        own = RunFolder(folder / str(number))
        try:
            config = checked_training([*fixed, *values])
            run = dataclasses.replace(config.run, dir=str(own))
            console.print(f"run {number}: {' '.join(values)}", **PLAIN)
            stop = train_missing(dataclasses.replace(config, run=run))
            if stop is not None and stop.asked:
                raise SearchEnded(stop.status)
            found = reached(own, objective)
        except ERRORS as error:
            raise SearchEnded(print_error(error)) from error
        console.print(f"run {number}: {objective} is {found:.6g}", **PLAIN)
        return found

    with run_lock(folder):
        try:
            build_sweeper(trial, hydra, folder).sweep(chosen)
        except SearchEnded as error:
            return error.status
    _show_best(console, folder, objective)
    return 0


def _show_best(console: Console, folder: Path, objective: str) -> None:
    """Says what the sweeper has found, if it writes that as Hydra's own do."""
    file = folder / FOUND
    if file.is_file() and "best_params" in (found := OmegaConf.load(file)):
        values = " ".join(f"{key}={value}" for key, value in found.best_params.items())
        console.print(f"best: {objective} is {found.best_value:.6g} with {values}", **PLAIN)
        console.print(f"  {file}", **PLAIN)
