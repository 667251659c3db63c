"""Hydra's plug-ins for sweeps, made with a configuration of Hydra's own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from hydra.experimental.callback import Callback
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from conf import ConfigError, register_schema
from conf.overrides import FOLDER
from conf.user_paths import quoted

Plugin = TypeVar("Plugin")


def instantiated(
    make: Callable[[HydraContext, DictConfig], Plugin],
    choices: Sequence[str],
    place: Path,
    keys: Sequence[str],
) -> Plugin:
    """A plug-in that Hydra overrides name; it says nothing by itself.

    Args:
        make: makes it of Hydra's context and configuration.
        choices: what is chosen of groups, such as ``hydra/launcher=ray``.
        place: Hydra's folder for the sweep.
        keys: what is set of ``hydra``.

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
                overrides=[*choices, *where, *quiet, *keys],
                run_mode=RunMode.MULTIRUN,
                with_log_configuration=False,
            )
            # A callback that does nothing: ``hydra.callbacks`` is no key that can be set here.
            context = HydraContext(hydra.config_loader, Callback())  # type: ignore[arg-type]
            return make(context, config)
        except (HydraException, OmegaConfBaseException, ImportError, RuntimeError) as error:
            raise ConfigError(str(error).strip().splitlines()[0]) from error
