"""What an agent can be told: the schema of the Hydra group ``agent`` and its checks.

The defaults are the values the paper gives and, where it gives none, those that were measured
(docs/assumptions.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

Problem = tuple[str, object, str]

WIDEST_LAYER = 4096
MOST_UPDATES = 100
LONGEST_RETURN = 100
MOST_TRANSITIONS = 10_000_000


@dataclass(frozen=True)
class DiscountConfig:
    """How much an agent values the next slot; 0 learns the immediate reward alone."""

    robot: float = 0.8
    ap: float = 0.0


@dataclass(frozen=True)
class TargetConfig:
    """When the target network follows the online one.

    ``every`` counts an agent's own stored transitions between copies. A ``tau`` replaces the
    copies by a soft target, moved by that share at every update.
    """

    every: int = 100
    tau: float | None = None


@dataclass(frozen=True)
class EpsilonConfig:
    """Linear exploration schedule over the run's first ticks."""

    start: float = 1.0
    end: float = 0.05
    ticks: int = 10_000


@dataclass(frozen=True)
class PriorityConfig:
    """Which transitions are replayed more often than others; an ``alpha`` of 0 draws them evenly.

    ``alpha`` is how far the error of a transition decides how often it is drawn, ``beta`` how far
    its weight in the loss makes up for that.
    """

    alpha: float = 0.0
    beta: float = 0.4


@dataclass(frozen=True)
class AgentConfig:
    """A DQN agent: its network, its replay and how it learns."""

    hidden: list[int] = field(default_factory=lambda: [64, 64])
    dueling: bool = False
    learning_rate: float = 1e-4
    learning_rate_end: float | None = None
    learning_rate_updates: int = 20_000
    batch_size: int = 128
    replay_size: int = 50_000
    learn_from: int = 128
    updates: int = 1
    n_step: int = 1
    double: bool = False
    huber_delta: float = 0.1
    reward_scale: float = 0.1
    discount: DiscountConfig = field(default_factory=DiscountConfig)
    priority: PriorityConfig = field(default_factory=PriorityConfig)
    target: TargetConfig = field(default_factory=TargetConfig)
    epsilon: EpsilonConfig = field(default_factory=EpsilonConfig)


def problems(config: AgentConfig) -> list[Problem]:
    """Lists what is wrong with a configuration.

    Args:
        config: the agent's configuration.

    Returns:
        One (key, value, sentence saying what is allowed) for each bad value or combination.
    """
    checks = (_network, _learning, _replay, _priority, _schedules)
    return [problem for check in checks for problem in check(config)]


def _network(config: AgentConfig) -> Iterator[Problem]:
    widths = list(config.hidden)
    if not widths or not all(_is_integer(w) and 1 <= w <= WIDEST_LAYER for w in widths):
        yield (
            "agent.hidden",
            widths,
            f"a list of one layer or more, each 1 to {WIDEST_LAYER} units wide",
        )


def _learning(config: AgentConfig) -> Iterator[Problem]:
    if config.learning_rate > 1:
        yield "agent.learning_rate", config.learning_rate, "at most 1"
    end, falls = config.learning_rate_end, config.learning_rate_updates
    if end is not None and not 0 <= end <= config.learning_rate:
        allowed = f"null, or from 0 to agent.learning_rate={config.learning_rate}"
        yield "agent.learning_rate_end", end, allowed
    if not _is_integer(falls) or falls < 1:
        yield "agent.learning_rate_updates", falls, "a whole number of at least 1"
    if not _is_integer(config.updates) or not 1 <= config.updates <= MOST_UPDATES:
        yield "agent.updates", config.updates, f"a whole number from 1 to {MOST_UPDATES}"
    if not _is_integer(config.n_step) or not 1 <= config.n_step <= LONGEST_RETURN:
        yield "agent.n_step", config.n_step, f"a whole number from 1 to {LONGEST_RETURN}"
    for key in ("learning_rate", "huber_delta", "reward_scale"):
        value = getattr(config, key)
        if not (math.isfinite(value) and value > 0):
            yield f"agent.{key}", value, "a finite number above 0"
    for key in ("robot", "ap"):
        value = getattr(config.discount, key)
        if not 0 <= value < 1:
            yield f"agent.discount.{key}", value, "at least 0 and below 1"


def _replay(config: AgentConfig) -> Iterator[Problem]:
    for key in ("batch_size", "replay_size", "learn_from"):
        value = getattr(config, key)
        if not _is_integer(value) or value < 1:
            yield f"agent.{key}", value, "a whole number of at least 1"
    if config.replay_size > MOST_TRANSITIONS:
        yield "agent.replay_size", config.replay_size, f"at most {MOST_TRANSITIONS}"
    for key in ("batch_size", "learn_from"):
        value = getattr(config, key)
        if value > config.replay_size:
            yield f"agent.{key}", value, f"at most agent.replay_size={config.replay_size}"


def _priority(config: AgentConfig) -> Iterator[Problem]:
    for key in ("alpha", "beta"):
        value = getattr(config.priority, key)
        if not 0 <= value <= 1:
            yield f"agent.priority.{key}", value, "from 0 to 1"


def _schedules(config: AgentConfig) -> Iterator[Problem]:
    target, epsilon = config.target, config.epsilon
    if not _is_integer(target.every) or target.every < 1:
        yield "agent.target.every", target.every, "a whole number of at least 1"
    if target.tau is not None and not 0 < target.tau <= 1:
        yield "agent.target.tau", target.tau, "null, or above 0 and at most 1"
    for key in ("start", "end"):
        value = getattr(epsilon, key)
        if not 0 <= value <= 1:
            yield f"agent.epsilon.{key}", value, "from 0 to 1"
    if epsilon.end > epsilon.start:
        yield (
            "agent.epsilon.end",
            epsilon.end,
            f"at most agent.epsilon.start={epsilon.start}",
        )
    if not _is_integer(epsilon.ticks) or epsilon.ticks < 1:
        yield "agent.epsilon.ticks", epsilon.ticks, "a whole number of at least 1"


def _is_integer(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)
