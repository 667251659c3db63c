"""The rules of a whole configuration: what depends on more than one field."""

from __future__ import annotations

import re
from collections.abc import Iterator

from agent import config as agent
from conf import (
    exchange_checks,
    own_checks,
    room_checks,
    scheme_checks,
    strategy_checks,
)
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
    found = validate.problems(config, ())
    found = found or [*_run_rules(config), *validate.problems(config.env, ENV_RULES, "env.")]
    return found or validate.problems(config, RULES)


def _run_rules(config: Config) -> Iterator[Problem]:
    clients, key, most = config.federation.clients, "env.robots", config.env.robots
    if has_rooms(config):
        key, most = "rooms.count", config.rooms.count
    if clients is not None and not 1 <= clients <= most:
        say = f"a number from 1 to {key}={most}, or null"
        yield "federation.clients", clients, say
    if config.run.id is not None and not RUN_ID.fullmatch(config.run.id):
        yield "run.id", config.run.id, "null, or 16 hexadecimal digits"
    yield from _deployment_rules(config)


def _deployment_rules(config: Config) -> Iterator[Problem]:
    """Keys that mean something in a deployment alone."""
    runtime = config.runtime
    if runtime.name == "deployment":
        if runtime.secure and runtime.connection is not None:
            say = "false with runtime.connection: the federation is as secure as it was started"
            yield "runtime.secure", True, say
        return
    say = f"with runtime={runtime.name}: only deployment reads it"
    if runtime.connection is not None:
        yield "runtime.connection", runtime.connection, f"null {say}"
    if runtime.secure:
        yield "runtime.secure", True, f"false {say}"


def _agent_rules(config: Config) -> Iterator[Problem]:
    return agent.rules(config.agent)


def _destination_rules(config: Config) -> list[Problem]:
    """Whether the floor holds the destinations that are drawn, and robots can drive to them.

    Both depend on the seed.
    """
    try:
        destinations = draw_destinations(config.env, stream(config.seed, Stream.DESTINATIONS))
    except ValueError as error:
        return [("env.robots", config.env.robots, f"fewer, or closer destinations: {error}")]
    return lateness.problems(config.env, destinations)


RULES = (
    _agent_rules,
    scheme_checks.rules,
    _destination_rules,
    strategy_checks.rules,
    room_checks.rules,
    exchange_checks.rules,
    own_checks.rules,
)
"""Each counts on those before it."""
