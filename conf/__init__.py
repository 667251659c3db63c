"""Hydra configuration: the YAML groups, their schema, and how a run's configuration is composed."""

from conf.checks import problems
from conf.compose import compose, from_yaml, overridden, register_schema, to_yaml
from conf.errors import ConfigError
from conf.exchange_schema import AttackConfig, LossesConfig, PrivacyConfig
from conf.fingerprint import fingerprint, version
from conf.networks import (
    ap_actions,
    ap_network,
    central_heads,
    joint_actions,
    learns_nothing,
    robot_actions,
    robot_network,
    robots_learn,
    weight_shapes,
)
from conf.schema import (
    Config,
    SchemeConfig,
    StrategyConfig,
    flower_clients,
    has_rooms,
    taking_part,
    waits_for_the_lost,
    windows_per_round,
)

__all__ = [
    "AttackConfig",
    "Config",
    "ConfigError",
    "LossesConfig",
    "PrivacyConfig",
    "SchemeConfig",
    "StrategyConfig",
    "ap_actions",
    "ap_network",
    "central_heads",
    "compose",
    "fingerprint",
    "flower_clients",
    "from_yaml",
    "has_rooms",
    "joint_actions",
    "learns_nothing",
    "overridden",
    "problems",
    "register_schema",
    "robot_actions",
    "robot_network",
    "robots_learn",
    "taking_part",
    "to_yaml",
    "version",
    "waits_for_the_lost",
    "weight_shapes",
    "windows_per_round",
]
