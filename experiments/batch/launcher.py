"""Hydra's plug-ins: launchers of jobs, processes by default or a cluster, and sweepers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from hydra.errors import HydraException
from hydra.experimental.callback import Callback
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, RunMode, TaskFunction
from omegaconf.errors import OmegaConfBaseException

from conf import ConfigError, register_schema
from conf.errors import first_sentence
from conf.overrides import FOLDER
from conf.user_paths import quoted

DEFAULT = "hydra/launcher=joblib"

Plugin = TypeVar("Plugin")


def build_launcher(
    task: TaskFunction, overrides: Sequence[str], place: Path, workers: int
) -> Launcher:
    """The launcher that Hydra overrides name: ``joblib``, a process for each core, if none.

    Args:
        task: what is called for each job.
        overrides: keys of Hydra itself, such as ``hydra/launcher=ray``.
        place: Hydra's folder for the sweep.
        workers: jobs at once, with ``joblib``.

    Raises:
        ConfigError: an override is wrong, or the launcher is not installed.
    """
    chosen = [item for item in overrides if item.startswith("hydra/launcher=")] or [DEFAULT]
    own = [item for item in overrides if not item.startswith("hydra/launcher=")]
    if chosen == [DEFAULT]:
        # A job each time a process is free: jobs are few and long.
        own = [f"hydra.launcher.n_jobs={workers}", "hydra.launcher.pre_dispatch=n_jobs", *own]
    return build_plugin(Plugins.instance().instantiate_launcher, task, [*chosen, *own], place)


def build_plugin(
    make: Callable[..., Plugin], task: Callable[..., Any], overrides: Sequence[str], place: Path
) -> Plugin:
    """A plug-in that Hydra overrides name; it says nothing by itself.

    Args:
        make: Hydra's function for such a plug-in.
        task: what is called for each job.
        overrides: what is chosen of groups, and keys of ``hydra``: the last one counts.
        place: Hydra's folder for the sweep.

    Raises:
        ConfigError: an override is wrong, or the plug-in is not installed.
    """
    quiet = ["hydra/job_logging=none", "hydra/hydra_logging=none", "hydra.output_subdir=null"]
    where = [f"hydra.sweep.dir={quoted(str(place))}", "hydra.sweep.subdir=."]
    register_schema()
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(FOLDER), version_base="1.3", job_name="risfleet"):
        hydra = GlobalHydra.instance().hydra
        assert hydra is not None
        try:
            config = hydra.compose_config(
                config_name="config",
                overrides=[*where, *quiet, *overrides],
                run_mode=RunMode.MULTIRUN,
                with_log_configuration=False,
            )
            # A callback that does nothing: ``hydra.callbacks`` is no key that can be set here.
            context = HydraContext(hydra.config_loader, Callback())  # type: ignore[arg-type]
            return make(hydra_context=context, task_function=task, config=config)
        except (HydraException, OmegaConfBaseException, ImportError, RuntimeError) as error:
            raise ConfigError(first_sentence(error)) from error
