"""A sweep whose values one of Hydra's sweepers chooses, each from what earlier runs reached."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.plugins import Plugins
from hydra.errors import HydraException
from hydra.experimental.callback import Callback
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from conf import ConfigError, register_schema
from conf.overrides import FOLDER
from conf.user_paths import quoted
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
    quiet = ["hydra/job_logging=none", "hydra/hydra_logging=none", "hydra.output_subdir=null"]
    where = [f"hydra.sweep.dir={quoted(str(place))}", "hydra.sweep.subdir=."]
    # With a seed the same command chooses the same values anew, and finds their runs done.
    ours = ["direction=maximize", "n_jobs=1"]
    ours += [] if "hydra/sweeper/sampler=grid" in hydra else ["sampler.seed=0"]
    ours = [f"hydra.sweeper.{item}" for item in ours if "hydra/sweeper=optuna" in hydra]

    def task(node: DictConfig) -> float:
        job = HydraConfig.get()
        return trial(int(job.job.num), list(job.overrides.task))

    register_schema()
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(FOLDER), version_base="1.3", job_name="risfleet"):
        loaded = GlobalHydra.instance().hydra
        assert loaded is not None
        try:
            config = loaded.compose_config(
                config_name="config",
                overrides=[*where, *quiet, *(item for item in hydra if "/" in item), *ours]
                + [item for item in hydra if "/" not in item],
                run_mode=RunMode.MULTIRUN,
                with_log_configuration=False,
            )
            context = HydraContext(loaded.config_loader, Callback())  # type: ignore[arg-type]
            sweeper = Plugins.instance().instantiate_sweeper(
                hydra_context=context, task_function=task, config=config
            )
        except (HydraException, OmegaConfBaseException, ImportError, RuntimeError) as error:
            raise ConfigError(str(error).strip().splitlines()[0]) from error
    logging.getLogger("optuna").setLevel(logging.WARNING)
    return sweeper
