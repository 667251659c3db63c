"""With what else robots may keep parts of their networks (``federation.own``, ``strategy=gossip``).

Both leave robots with networks that differ from each other.
"""

from __future__ import annotations

from collections.abc import Iterator

from conf.errors import shown
from conf.exchange_checks import missing_uploads
from conf.networks import robots_learn
from conf.schema import Config, changed, has_rooms
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
        for key, value, allowed in changed(config.federation.compression):
            if key in ("down", "targets"):
                say = f"{allowed} with {who}: robots are not given one model"
                yield f"federation.compression.{key}", value, say
        yield from _altered(config, who)


def _altered(config: Config, who: str) -> Iterator[Problem]:
    """What would change or hold back what a robot keeps of its own, for it takes what it sent."""
    say = f"with {who}: what robots keep comes back as they sent it"
    if config.federation.compression.up != "none":
        yield "federation.compression.up", config.federation.compression.up, f"none {say}"
    if config.strategy.dp.name == "local":
        yield "strategy.dp.name", "local", f"none {say}"
    if config.attack.name != "none":
        yield "attack.name", config.attack.name, f"none {say}"
    for key, value, off in missing_uploads(config.federation):
        yield key, value, f"{shown(off)} {say}"


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
