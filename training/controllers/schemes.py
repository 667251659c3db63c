"""Who decides in a run: what the group ``scheme`` says, made."""

from __future__ import annotations

from conf import Config
from env.world import World
from training.controllers.access_point import AccessPoint
from training.controllers.central import BranchingAgent, CentralAgent, JointAgent
from training.controllers.phase_rules import PhaseRule
from training.controllers.service import RisController


def build_ris_controller(config: Config, world: World) -> RisController:
    """Who steers the RIS, as the run begins; a ``CentralAgent`` commands the robots, too."""
    if config.scheme.agents != "federated":
        return build_central(config)
    if config.scheme.phase != "learned":
        return PhaseRule(config, world)
    return AccessPoint(config)


def build_central(config: Config) -> CentralAgent:
    """The one agent for everything, with ``scheme.agents`` centralized or branching."""
    made = {"centralized": JointAgent, "branching": BranchingAgent}
    return made[config.scheme.agents](config)
