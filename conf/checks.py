"""The rules of a whole configuration: what depends on more than one field."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator

from agent import config as agent
from conf import exchange_checks, room_checks, scheme_checks, strategy_checks
from conf.schema import Config, has_rooms
from env import validate
from env.config_checks import RULES as ENV_RULES
from env.mdp import lateness
from env.mdp.destinations import draw_destinations
from env.seeding import Stream, stream
from env.validate import Problem

RUN_ID = re.compile(r"[0-9a-f]{16}")
"""Robots make a folder of this name."""


def problems(config: Config) -> list[Problem]:
    """Lists what is wrong with a configuration: keys, their values, and what is allowed."""
    found = list(validate.value_problems(config))
    found = found or [*_run_rules(config), *validate.problems(config.env, ENV_RULES, "env.")]
    return found or validate.problems(config, RULES)


def _run_rules(config: Config) -> Iterator[Problem]:
    """The clients, the run's name, and keys that mean something in a deployment alone."""
    clients, key, most = config.federation.clients, "env.robots", config.env.robots
    if has_rooms(config):
        key, most = "rooms.count", config.rooms.count
    if clients is not None and not 1 <= clients <= most:
        say = f"a number from 1 to {key}={most}, or null"
        yield "federation.clients", clients, say
    if config.run.id is not None and not RUN_ID.fullmatch(config.run.id):
        yield "run.id", config.run.id, "null, or 16 hexadecimal digits"
    runtime = config.runtime
    connected, say = runtime.connection is not None, f"with runtime={runtime.name}: only deployment"
    if runtime.name != "deployment":
        if connected:
            yield "runtime.connection", runtime.connection, f"null {say} reads it"
        if runtime.secure:
            yield "runtime.secure", True, f"false {say} reads it"
    elif runtime.secure and connected:
        say = "false with runtime.connection: the federation is as secure as it was started"
        yield "runtime.secure", True, say


def _destination_rules(config: Config) -> list[Problem]:
    """Whether the floor holds the destinations that the seed draws, and robots reach them."""
    try:
        destinations = draw_destinations(config.env, stream(config.seed, Stream.DESTINATIONS))
    except ValueError as error:
        return [("env.robots", config.env.robots, f"fewer, or closer destinations: {error}")]
    return lateness.problems(config.env, destinations)


RULES: tuple[Callable[[Config], Iterable[Problem]], ...] = (
    lambda config: agent.rules(config.agent),
    scheme_checks.rules,
    _destination_rules,
    lambda config: strategy_checks.problems(config.strategy, config.env.robots, "env.robots"),
    room_checks.rules,
    exchange_checks.rules,
    exchange_checks.own_rules,
)
"""Each counts on those before it."""
