"""RISFleet from Python: train, look at what came of it, evaluate, act, sweep.

| name | what it is |
|---|---|
| `train`, `sweep` | trains a run, or one for each combination of values |
| `load`, `Run` | a run's folder: configuration, measures, frozen weights |
| `evaluate`, `Evaluation` | what learns nothing on held-out starts, and what an evaluation found |
| `Replay` | an episode that plays in a notebook's cell, as a page or as a film |
| `Policy` | frozen networks: from observations to actions |
| `compose`, `Config`, `ConfigError` | a checked configuration; the error of every mistake in one |
| `make_env`, `RISFleetParallelEnv`, `SingleRobotEnv` | the world, to step through by yourself |
| `register_reward`, `register_channel_model` | models of your own |

These names are stable; the packages beside this one are where they come from, and may change. They
are imported when they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from conf import Config, ConfigError
    from env import RISFleetParallelEnv, SingleRobotEnv, register_channel_model, register_reward
    from risfleet.evaluation import Evaluation, evaluate
    from risfleet.replays import Replay
    from risfleet.runs import Run, load
    from risfleet.training import SweepError, compose, make_env, sweep, train
    from training.policy import AccessPointPolicy, Policy

    __version__: str

__all__ = [
    "AccessPointPolicy",
    "Config",
    "ConfigError",
    "Evaluation",
    "Policy",
    "RISFleetParallelEnv",
    "Replay",
    "Run",
    "SingleRobotEnv",
    "SweepError",
    "__version__",
    "compose",
    "evaluate",
    "load",
    "make_env",
    "register_channel_model",
    "register_reward",
    "sweep",
    "train",
]

_NAMES = {
    "conf": ("Config", "ConfigError"),
    "env": ("RISFleetParallelEnv", "SingleRobotEnv", "register_channel_model", "register_reward"),
    "risfleet.evaluation": ("Evaluation", "evaluate"),
    "risfleet.replays": ("Replay",),
    "risfleet.runs": ("Run", "load"),
    "risfleet.training": ("SweepError", "compose", "make_env", "sweep", "train"),
    "training.policy": ("AccessPointPolicy", "Policy"),
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version(__name__)
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from experiments.cli import hidden_package

    if hidden := hidden_package():
        raise ImportError(hidden)
    found = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return found


def __dir__() -> list[str]:
    return __all__
