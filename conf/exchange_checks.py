"""What is allowed of the exchange of weights: how they are packed, who is heard, and who lies."""

from __future__ import annotations

from collections.abc import Iterator

from conf.errors import shown
from conf.exchange_schema import AttackConfig, CompressionConfig
from conf.networks import robots_learn
from conf.schema import Config, FederationConfig, changed, has_rooms
from conf.strategy_checks import FULL_NUMBER
from env.validate import Problem

AVERAGES = ("fedavg", "fedprox", "fedmedian", "krum")
"""Strategies without a memory of the whole model: they combine a part of it as well."""


def rules(config: Config) -> Iterator[Problem]:
    """What is wrong with how weights are exchanged, of a configuration otherwise right."""
    yield from _attack_problems(config)
    yield from _loss_problems(config)
    chosen = config.federation.compression
    hear = config.federation.hear
    if not robots_learn(config) or config.strategy.name == "none":
        who = f"strategy={config.strategy.name}" if robots_learn(config) else "these agents"
        say = f"with {who}: no weights are exchanged"
        for key, value, default in changed(chosen):
            yield f"federation.compression.{key}", value, f"{shown(default)} {say}"
        return
    keep = CompressionConfig().keep
    if chosen.keep != keep and "topk" not in (chosen.up, chosen.down):
        say = f"{keep} here: only topk reads it, in compression.up or compression.down"
        yield "federation.compression.keep", chosen.keep, say
    if hear is not None:
        yield from _hearing(config, hear)
    yield from _privacy(config)


def _hearing(config: Config, hear: int) -> Iterator[Problem]:
    """Fewer robots than there are."""
    most = min(config.rooms.robots or [config.env.robots])
    if hear > most:
        yield "federation.hear", hear, f"a number from 1 to the robots there are, {most}, or null"


def _privacy(config: Config) -> Iterator[Problem]:
    """Noise at the server is measured for the mean of all robots' steps of a window."""
    name, federation = config.strategy.dp.name, config.federation
    if name not in ("central", "adaptive"):
        return
    say = f"with strategy/dp={name}: its noise is measured for all robots' steps, one a window"
    if federation.own != "none":
        yield "federation.own", federation.own, f"none {say}"
    for key, value, off in missing_uploads(federation):
        yield key, value, f"{shown(off)} {say}"


def missing_uploads(federation: FederationConfig) -> Iterator[tuple[str, object, object]]:
    """The keys by which uploads do not come or come late, where they are set: key, value, off."""
    for key, value, off in changed(federation):
        if key in ("hear", "fraction"):
            yield f"federation.{key}", value, off
    for key, value, off in changed(federation.losses):
        yield f"federation.losses.{key}", value, off


def _attack_problems(config: Config) -> Iterator[Problem]:
    attack, robots, default = config.attack, config.env.robots, AttackConfig()
    if attack.name == "none":
        for key, value, off in changed(attack):
            yield f"attack.{key}", value, f"{off} with attack=none: nobody is hostile"
    elif config.strategy.name == "none":
        yield "attack.name", attack.name, "none with strategy=none: nobody else takes an upload"
    elif has_rooms(config):
        yield "attack.name", attack.name, "none in a building"
    elif not 1 <= attack.robots < robots:
        say = f"from 1 to {robots - 1}: some of env.robots={robots} are hostile, and not all"
        yield "attack.robots", attack.robots, say
    elif attack.name == "stale" and attack.scale != default.scale:
        say = f"{default.scale} with attack=stale: only noise, flip and scale read it"
        yield "attack.scale", attack.scale, say


def _loss_problems(config: Config) -> Iterator[Problem]:
    """Uploads that are missing where nothing, or a strategy that needs all, is to take them."""
    name, federation = config.strategy.name, config.federation
    for key, value, off in missing_uploads(federation):
        if name == "none":
            yield key, value, f"{shown(off)} with strategy=none: nothing is uploaded"
        elif name in FULL_NUMBER:
            yield key, value, f"{shown(off)} with strategy={name}, which needs the uploads of all"
    if federation.hear is not None and federation.fraction < 1:
        say = "1.0 with federation.hear: either chooses whom the server asks"
        yield "federation.fraction", federation.fraction, say
    if name == "visits" and federation.losses.late:
        say = "0.0 with strategy=visits, which counts by what was visited in the same window"
        yield "federation.losses.late", federation.losses.late, say


def own_rules(config: Config) -> Iterator[Problem]:
    """With what robots may keep networks that differ (``federation.own``, ``strategy=gossip``)."""
    own = config.federation.own
    if own != "none":
        key = "federation.own"
        if not robots_learn(config):
            yield key, own, "none where robots have no networks (scheme.agents, scheme.robots)"
        elif has_rooms(config):
            yield key, own, "none in a building: a room hands on one network"
        elif config.strategy.name not in AVERAGES:
            say = f"none with strategy={config.strategy.name}: {', '.join(AVERAGES)} combine a part"
            yield key, own, say
    elif config.strategy.name != "gossip":
        return
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
