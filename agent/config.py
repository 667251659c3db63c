"""The schema of the Hydra group ``agent``, and the rules that hold between its fields.

The defaults are the values the paper gives and, where it gives none, those that were measured
(docs/assumptions.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Ge, Gt, Interval, MinLen

Problem = tuple[str, object, str]

Share = Annotated[float, Interval(ge=0, le=1)]
Discount = Annotated[float, Interval(ge=0, lt=1)]
Positive = Annotated[float, Gt(0)]
Count = Annotated[int, Ge(1)]


@dataclass(frozen=True)
class DiscountConfig:
    """How much an agent values the next slot; 0 learns the immediate reward alone."""

    robot: Discount = 0.8
    ap: Discount = 0.0


@dataclass(frozen=True)
class TargetConfig:
    """When the target network follows the online one.

    ``every`` counts an agent's own stored transitions between copies. A ``tau`` replaces the
    copies by a soft target, moved by that share at every update.
    """

    every: Annotated[Count, "N_Q, in an agent's own stored transitions"] = 100
    tau: Annotated[
        float | None, Interval(gt=0, le=1), "the target follows softly, at every update"
    ] = None


@dataclass(frozen=True)
class EpsilonConfig:
    """Linear exploration schedule over the run's first ticks."""

    start: Share = 1.0
    end: Share = 0.05
    ticks: Annotated[Count, "of the run"] = 10_000


@dataclass(frozen=True)
class AgentConfig:
    """A DQN agent: its network, its replay and how it learns."""

    hidden: Annotated[list[Annotated[int, Interval(ge=1, le=4096)]], MinLen(1)] = field(
        default_factory=lambda: [64, 64]
    )
    learning_rate: Annotated[float, Interval(gt=0, le=1), "alpha, Table I"] = 1e-4
    learning_rate_end: Annotated[float | None, Ge(0), "a number: it falls to that ..."] = None
    learning_rate_updates: Annotated[Count, "... over so many updates of an agent's own"] = 20_000
    batch_size: Annotated[Count, "|D_0|, Table I"] = 128
    replay_size: Annotated[int, Interval(ge=1, le=10_000_000)] = 50_000
    learn_from: Annotated[Count, "transitions held before the first update"] = 128
    updates: Annotated[int, Interval(ge=1, le=100), "gradient steps after each transition"] = 1
    double: bool = False
    huber_delta: Annotated[Positive, "in scaled reward; at 1 the rare goal disturbs all else"] = 0.1
    reward_scale: Annotated[Positive, "for learning only; rewards are reported unscaled"] = 0.1
    discount: DiscountConfig = field(default_factory=DiscountConfig)
    target: TargetConfig = field(default_factory=TargetConfig)
    epsilon: EpsilonConfig = field(default_factory=EpsilonConfig)


def rules(config: AgentConfig) -> Iterator[Problem]:
    """What depends on two fields: keys, their values, and what is allowed there."""
    end = config.learning_rate_end
    if end is not None and end > config.learning_rate:
        allowed = f"null, or from 0 to agent.learning_rate={config.learning_rate}"
        yield "agent.learning_rate_end", end, allowed
    for key in ("batch_size", "learn_from"):
        value = getattr(config, key)
        if value > config.replay_size:
            yield f"agent.{key}", value, f"at most agent.replay_size={config.replay_size}"
    epsilon = config.epsilon
    if epsilon.end > epsilon.start:
        yield "agent.epsilon.end", epsilon.end, f"at most agent.epsilon.start={epsilon.start}"
