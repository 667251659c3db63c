"""What is allowed in a configuration, beyond the types of its schema."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from agent.config import problems as agent_problems
from conf.schema import Config
from conf.scheme_checks import problems as scheme_problems
from env import lateness
from env.config import Problem
from env.config_checks import problems as env_problems
from env.destinations import draw_destinations
from env.seeding import Stream, stream

RUNTIMES = ("local", "simulation", "deployment")
ON_LOSS = ("wait", "abort")


RUN_ID = re.compile(r"[0-9a-f]{16}")
"""Robots make a folder of this name."""


@dataclass(frozen=True)
class Range:
    """Numbers from ``low``, to ``high`` where there is one; or null where that has a meaning."""

    low: float
    high: float | None = None
    null: bool = False

    def holds(self, value: Any) -> bool:
        """Whether a value is allowed."""
        if value is None:
            return self.null
        return bool(value >= self.low and (self.high is None or value <= self.high))

    def __str__(self) -> str:
        """What is allowed, in words."""
        bounds = f"of at least {self.low:.15g}"
        if self.high is not None:
            bounds = f"from {self.low:.15g} to {self.high:.15g}"
        return f"a number {bounds}" + (", or null" if self.null else "")


SECONDS = Range(0.1, 86_400)
RANGES = {
    "seed": Range(0),
    "train.episodes": Range(1),
    "train.max_ticks": Range(1, null=True),
    "federation.every": Range(1, 1_000_000),
    "federation.windows_per_round": Range(1, null=True),
    "federation.loss_timeout_s": SECONDS,
    "federation.link.port": Range(0, 65_535),
    "federation.link.timeout_s": SECONDS,
    "federation.link.patience_s": SECONDS,
    "runtime.start_timeout_s": SECONDS,
    "state.every": Range(1, null=True),
    "evaluation.every": Range(1),
    "evaluation.episodes": Range(1, 100_000),
    "evaluation.epsilon": Range(0, 1),
}


def problems(config: Config) -> list[Problem]:
    """Lists what is wrong with a configuration: keys, their values, and what is allowed."""
    found = [*_run_problems(config), *env_problems(config.env), *agent_problems(config.agent)]
    return found or [*scheme_problems(config), *_destination_problems(config)]


def _run_problems(config: Config) -> list[Problem]:
    robots, clients = config.env.robots, config.federation.clients
    found: list[Problem] = []
    if config.runtime.name not in RUNTIMES:
        found.append(("runtime.name", config.runtime.name, f"one of {', '.join(RUNTIMES)}"))
    if config.federation.on_loss not in ON_LOSS:
        found.append(("federation.on_loss", config.federation.on_loss, " or ".join(ON_LOSS)))
    for key, allowed in RANGES.items():
        value: Any = config
        for name in key.split("."):
            value = getattr(value, name)
        if not allowed.holds(value):
            found.append((key, value, str(allowed)))
    found += _deployment_problems(config)
    if clients is not None and not 1 <= clients <= robots:
        say = f"a number from 1 to env.robots={robots}, or null"
        found.append(("federation.clients", clients, say))
    return found


def _deployment_problems(config: Config) -> list[Problem]:
    """Keys that mean something in a deployment alone."""
    runtime = config.runtime
    found: list[Problem] = []
    if runtime.name != "deployment":
        say = "{} with runtime={}: only deployment reads it"
        if runtime.connection is not None:
            allowed = say.format("null", runtime.name)
            found.append(("runtime.connection", runtime.connection, allowed))
        if runtime.secure:
            found.append(("runtime.secure", True, say.format("false", runtime.name)))
    elif runtime.secure and runtime.connection is not None:
        say = "false with runtime.connection: the federation there is as secure as it was started"
        found.append(("runtime.secure", True, say))
    if config.run.id is not None and not RUN_ID.fullmatch(config.run.id):
        found.append(("run.id", config.run.id, "null, or 16 hexadecimal digits"))
    return found


def _destination_problems(config: Config) -> list[Problem]:
    """Whether the floor holds the destinations that are drawn, and robots can drive to them.

    Both depend on the seed.
    """
    try:
        destinations = draw_destinations(config.env, stream(config.seed, Stream.DESTINATIONS))
    except ValueError as error:
        return [("env.robots", config.env.robots, f"fewer, or closer destinations: {error}")]
    return lateness.problems(config.env, destinations)
