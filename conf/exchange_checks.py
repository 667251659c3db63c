"""What is allowed of the exchange of weights: how they are packed, and who is heard."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

from conf.errors import shown
from conf.networks import robots_learn
from conf.schema import CompressionConfig, Config
from env.validate import Problem


def rules(config: Config) -> Iterator[Problem]:
    """What is wrong with how weights are exchanged: keys, their values, and what is allowed.

    Args:
        config: free of other problems.
    """
    chosen, default = config.federation.compression, CompressionConfig()
    hear = config.federation.hear
    if not robots_learn(config) or config.strategy.name == "none":
        who = f"strategy={config.strategy.name}" if robots_learn(config) else "these agents"
        say = f"with {who}: no weights are exchanged"
        for item in fields(chosen):
            value, usual = getattr(chosen, item.name), getattr(default, item.name)
            if value != usual:
                yield f"federation.compression.{item.name}", value, f"{shown(usual)} {say}"
        if hear is not None:
            yield "federation.hear", hear, f"null {say}"
        return
    if chosen.keep != default.keep and "topk" not in (chosen.up, chosen.down):
        say = f"{default.keep} here: only topk reads it, in compression.up or compression.down"
        yield "federation.compression.keep", chosen.keep, say
    if hear is not None:
        yield from _hearing(config, hear)


def _hearing(config: Config, hear: int) -> Iterator[Problem]:
    """Fewer robots than there are, and a strategy that takes fewer."""
    most = min(config.rooms.robots or [config.env.robots])
    if hear > most:
        yield "federation.hear", hear, f"a number from 1 to the robots there are, {most}, or null"
    if config.strategy.name == "krum":
        yield "federation.hear", hear, "null with strategy=krum, which needs its full number"
