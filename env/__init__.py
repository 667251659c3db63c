"""The world of RISFleet: physics on NumPy alone, and views for Gymnasium and PettingZoo.

Importing ``env`` registers ``risfleet/SingleRobot-v0`` where Gymnasium is installed, and
``risfleet/Fleet-v0`` among PettingZoo's parallel environments where that has a registry (from 1.27
on); the physics needs neither. The names below are imported when they are first used.
"""

from __future__ import annotations

import contextlib
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from env.apis.parallel_env import RISFleetParallelEnv
    from env.apis.single_robot import SingleRobotEnv
    from env.apis.single_robot_vector import SingleRobotVectorEnv
    from env.checks import checked_config
    from env.config import EnvConfig
    from env.plugins import register_channel_model, register_reward
    from env.scenario import Scenario
    from env.world import World

__all__ = [
    "EnvConfig",
    "RISFleetParallelEnv",
    "Scenario",
    "SingleRobotEnv",
    "SingleRobotVectorEnv",
    "World",
    "checked_config",
    "register_channel_model",
    "register_reward",
]

SINGLE_ROBOT = "risfleet/SingleRobot-v0"
FLEET = "risfleet/Fleet-v0"
_HOMES = {
    "env.apis.parallel_env": ["RISFleetParallelEnv"],
    "env.apis.single_robot": ["SingleRobotEnv"],
    "env.apis.single_robot_vector": ["SingleRobotVectorEnv"],
    "env.checks": ["checked_config"],
    "env.config": ["EnvConfig"],
    "env.plugins": ["register_channel_model", "register_reward"],
    "env.scenario": ["Scenario"],
    "env.world": ["World"],
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(module), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


with contextlib.suppress(ImportError):
    import gymnasium

    if SINGLE_ROBOT not in gymnasium.registry:
        gymnasium.register(
            id=SINGLE_ROBOT,
            entry_point="env.apis.single_robot:SingleRobotEnv",
            vector_entry_point="env.apis.single_robot_vector:SingleRobotVectorEnv",
        )

with contextlib.suppress(ImportError):
    from pettingzoo import parallel_registry, register  # type: ignore[import-untyped]

    if FLEET not in parallel_registry:
        register("parallel", FLEET, "env.apis.parallel_env:RISFleetParallelEnv")
