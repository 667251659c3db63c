"""The sizes of the networks that a configuration describes, for every side that builds one."""

from __future__ import annotations

from agent import NetworkShape
from conf.schema import Config
from env import actions
from env.config import phase_actions
from env.observation import Observer


def robot_network(config: Config) -> NetworkShape:
    """The DQN of each robot: s_L to 4 N_P actions."""
    return NetworkShape(
        Observer(config.env).local_size,
        tuple(config.agent.hidden),
        actions.count(config.env.power.levels),
    )


def ap_network(config: Config) -> NetworkShape:
    """The DQN of the access point: s_G to its phase settings or its codebook's beams."""
    return NetworkShape(
        Observer(config.env).global_size,
        tuple(config.agent.hidden),
        phase_actions(config.env.ris),
    )
