"""From the uploads that were heard to what robots hold: one model for all, or each its own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from conf import Config, robot_network
from training.aggregation.gossip import Gossip
from training.aggregation.strategies import build_aggregator
from training.aggregation.visits import VisitMean
from training.checkpoint import flat, part
from training.exchange.facts import WindowFacts
from training.exchange.own_parts import OwnParts, own_parts
from training.exchange.reception import Heard

if TYPE_CHECKING:
    from training.aggregation.aggregator import Aggregator

Weights = NDArray[np.float32]
State = dict[str, NDArray[Any]]


class Combiner(ABC):
    """Combines the networks of a window; keeps nothing, and looks at weights alone, by default."""

    @abstractmethod
    def combine(self, window: int, given: Weights, heard: Heard, facts: WindowFacts) -> Weights:
        """What robots go on from, shape (2, P), or each its own, (K, 2, P).

        Args:
            window: the window's number.
            given: what each robot started the window from, shape (K, 2, P).
            heard: the uploads that count, of at least one robot.
            facts: of the window.
        """

    def observed(self, updates: np.ndarray) -> None:  # noqa: B027 - most look at weights alone
        """Takes notice of the records of a step, shape (K E,)."""

    def state(self) -> State:
        """What it keeps between windows."""
        return {}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:  # noqa: B027 - as above
        """Takes back what ``state`` gave."""


class Averaged(Combiner):
    """A Flower strategy over networks, or over what robots share of them.

    Args:
        aggregator: the strategy.
        own: what stays each robot's own; None: nothing.
    """

    def __init__(self, aggregator: Aggregator, own: OwnParts | None = None) -> None:
        self._aggregator, self._own = aggregator, own

    def observed(self, updates: np.ndarray) -> None:
        """See ``Combiner.observed``."""
        if self._own is not None:
            self._own.observed(updates)

    def combine(self, window: int, given: Weights, heard: Heard, facts: WindowFacts) -> Weights:
        """See ``Combiner.combine``; what robots share is the same before as after."""
        if self._own is None:
            return self._aggregator.aggregate(window, given[0], heard.rows)
        current = self._own.shared(given[:1], np.array([0]))[0]
        shared = self._own.shared(heard.rows, heard.robots)
        rows = np.array(given)
        rows[heard.robots] = heard.rows
        return self._own.merged(rows, self._aggregator.aggregate(window, current, shared))

    def state(self) -> State:
        """See ``Combiner.state``."""
        own = {} if self._own is None else self._own.state()
        return flat({"strategy": self._aggregator.state(), "own": own})

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """See ``Combiner.restore``."""
        self._aggregator.restore(part(state, "strategy"))
        if self._own is not None:
            self._own.restore(part(state, "own"))


class Gossiped(Combiner):
    """Robots that mix with their neighbours."""

    def __init__(self, gossip: Gossip) -> None:
        self._gossip = gossip

    def combine(self, window: int, given: Weights, heard: Heard, facts: WindowFacts) -> Weights:
        """See ``Combiner.combine``; a robot that nobody heard has what it started from."""
        rows = np.array(given)
        rows[heard.robots] = self._gossip.mix(window, heard.rows)
        return rows


class ByVisits(Combiner):
    """Robots that count by what they have visited in the window."""

    def __init__(self, mean: VisitMean) -> None:
        self._mean = mean

    def combine(self, window: int, given: Weights, heard: Heard, facts: WindowFacts) -> Weights:
        """See ``Combiner.combine``."""
        return self._mean.mean(heard.rows, facts.actions[heard.robots])


def build_combiner(config: Config) -> Combiner | None:
    """Makes the combiner of a run, or None where each robot keeps its own weights."""
    if config.strategy.name == "gossip":
        return Gossiped(Gossip(config.strategy, config.seed))
    if config.strategy.name == "visits":
        return ByVisits(VisitMean(robot_network(config)))
    aggregator = build_aggregator(
        config.strategy,
        config.env.robots,
        partial=True,
        seed=config.seed,
        targets=config.federation.compression.targets == "averaged",
    )
    return None if aggregator is None else Averaged(aggregator, own_parts(config))
