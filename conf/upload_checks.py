"""What is allowed of robots that upload falsely, late or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

from conf.schema import AttackConfig, Config, LossesConfig, has_rooms
from conf.strategy_checks import FULL_NUMBER
from env.validate import Problem


def rules(config: Config) -> Iterator[Problem]:
    """What is wrong with a configuration: keys, their values, and what is allowed.

    Args:
        config: free of other problems.
    """
    yield from _attack_problems(config)
    yield from _loss_problems(config)


def _attack_problems(config: Config) -> Iterator[Problem]:
    attack, robots, default = config.attack, config.env.robots, AttackConfig()
    if attack.name == "none":
        for key in ("robots", "scale"):
            if getattr(attack, key) != getattr(default, key):
                say = f"{getattr(default, key)} with attack=none: nobody is hostile"
                yield f"attack.{key}", getattr(attack, key), say
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
    federation, default = config.federation, LossesConfig()
    given = [("federation.fraction", federation.fraction, 1.0)]
    for item in fields(default):
        value = getattr(federation.losses, item.name)
        given.append((f"federation.losses.{item.name}", value, getattr(default, item.name)))
    name = config.strategy.name
    for key, value, off in given:
        shown = "null" if off is None else off
        if value != off and name == "none":
            yield key, value, f"{shown} with strategy=none: nothing is uploaded"
        elif value != off and name in FULL_NUMBER:
            yield key, value, f"{shown} with strategy={name}, which needs the uploads of all"
