"""Hydra configuration: the YAML groups, their schema, and how a run's configuration is composed."""

from conf.checks import problems
from conf.compose import (
    ConfigError,
    compose,
    from_composed,
    from_yaml,
    overridden,
    register_schema,
    to_yaml,
)
from conf.fingerprint import fingerprint, version
from conf.networks import ap_network, robot_network
from conf.schema import (
    Config,
    StrategyConfig,
    flower_clients,
    waits_for_the_lost,
    windows_per_round,
)

__all__ = [
    "Config",
    "ConfigError",
    "StrategyConfig",
    "ap_network",
    "compose",
    "fingerprint",
    "flower_clients",
    "from_composed",
    "from_yaml",
    "overridden",
    "problems",
    "register_schema",
    "robot_network",
    "to_yaml",
    "version",
    "waits_for_the_lost",
    "windows_per_round",
]
