"""A sweep whose values one of Hydra's sweepers chooses, each from what earlier runs reached."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.core.plugins import Plugins
from hydra.plugins.sweeper import Sweeper
from omegaconf import DictConfig

from conf import ConfigError
from experiments.batch.launcher import build_plugin
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

    choices = [item for item in hydra if "/" in item]
    keys = [*ours, *(item for item in hydra if "/" not in item)]
    sweeper = build_plugin(Plugins.instance().instantiate_sweeper, task, [*choices, *keys], place)
    logging.getLogger("optuna").setLevel(logging.WARNING)
    return sweeper
