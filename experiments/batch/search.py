"""A sweep whose values one of Hydra's sweepers chooses, each from what earlier runs reached."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.core.plugins import Plugins
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext
from omegaconf import DictConfig

from conf import ConfigError
from experiments.batch.plugins import instantiated
from training.run_folder import RunFolder

MEASURES = ("success", "ee", "ee_bits_per_joule", "sum_rate", "min_rate", "path_ratio")
PARTS = ("greedy", "eps05", "last5", "last5_greedy")
OBJECTIVE = "greedy.ee"

Trial = Callable[[int, Sequence[str]], float]
"""Trains the run of a number with what was chosen for it; gives what it reached."""


def check_objective(text: str) -> str:
    """The measure that ``--objective`` names.

    Raises:
        ConfigError: there is none of that name.
    """
    part, _, measure = text.rpartition(".")
    if measure not in MEASURES or part not in ("", *PARTS):
        allowed = (
            f"one of {', '.join(MEASURES)}, with one of {', '.join(PARTS)} and a dot before it"
        )
        raise ConfigError(f"--objective {text}: allowed is {allowed}.")
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

    Args:
        trial: what is called for each run.
        hydra: overrides of Hydra's own keys, such as ``hydra/sweeper=optuna``.
        place: Hydra's folder for the sweep.

    Raises:
        ConfigError: an override is wrong, or the sweeper is not installed.
    """
    # With a seed the same command chooses the same values anew, and finds their runs done.
    ours = ["direction=maximize", "n_jobs=1"]
    ours += [] if "hydra/sweeper/sampler=grid" in hydra else ["sampler.seed=0"]
    ours = [f"hydra.sweeper.{item}" for item in ours if "hydra/sweeper=optuna" in hydra]

    def task(node: DictConfig) -> float:
        job = HydraConfig.get()
        return trial(int(job.job.num), list(job.overrides.task))

    def make(context: HydraContext, config: DictConfig) -> Sweeper:
        return Plugins.instance().instantiate_sweeper(
            hydra_context=context, task_function=task, config=config
        )

    choices = [item for item in hydra if "/" in item]
    keys = [*ours, *(item for item in hydra if "/" not in item)]
    sweeper = instantiated(make, choices, place, keys)
    logging.getLogger("optuna").setLevel(logging.WARNING)
    return sweeper
