"""With what else robots may keep parts of their networks (``federation.own``, ``strategy=gossip``).

Both leave robots with networks that differ from each other.
"""

from __future__ import annotations

from collections.abc import Iterator

from conf.exchange_schema import CompressionConfig
from conf.networks import robots_learn
from conf.schema import Config, has_rooms
from env.validate import Problem

AVERAGES = ("fedavg", "fedprox", "fedmedian", "krum")
"""Strategies without a memory of the whole model: they combine a part of it as well."""


def rules(config: Config) -> Iterator[Problem]:
    """What is wrong with own parts: keys, their values, and what is allowed.

    Args:
        config: free of other problems.
    """
    own = config.federation.own
    if own != "none":
        yield from _own_problems(config)
    if own != "none" or config.strategy.name == "gossip":
        who = "strategy=gossip" if own == "none" else f"federation.own={own}"
        compression, default = config.federation.compression, CompressionConfig()
        for key in ("down", "targets"):
            value, allowed = getattr(compression, key), getattr(default, key)
            if value != allowed:
                say = f"{allowed} with {who}: robots are not given one model"
                yield f"federation.compression.{key}", value, say


def _own_problems(config: Config) -> Iterator[Problem]:
    """Strategies, buildings and baselines that have no use for own parts."""
    key, own = "federation.own", config.federation.own
    if not robots_learn(config):
        yield key, own, "none where robots have no networks (scheme.agents, scheme.robots)"
    elif has_rooms(config):
        yield key, own, "none in a building: a room hands on one network"
    elif config.strategy.name not in AVERAGES:
        say = f"none with strategy={config.strategy.name}: {', '.join(AVERAGES)} combine a part"
        yield key, own, say
