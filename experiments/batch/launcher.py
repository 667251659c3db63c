"""Jobs through Hydra's launcher plug-ins: processes by default, a cluster where one is set up."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hydra.core.plugins import Plugins
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

from experiments.batch.plugins import instantiated

DEFAULT = "hydra/launcher=joblib"


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

    def make(context: HydraContext, config: DictConfig) -> Launcher:
        return Plugins.instance().instantiate_launcher(
            hydra_context=context, task_function=task, config=config
        )

    return instantiated(make, chosen, place, own)
