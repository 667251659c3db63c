"""The server's side of the exchange of weights: from uploads to what robots go on from.

One window after the other: uploads are unpacked, those that were heard are combined, and what
robots take is packed. By default all is heard, a Flower strategy combines, and one model is sent to
everybody as it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from conf import Config, robot_network
from lockstep import Payload
from training.aggregation.strategies import build_aggregator
from training.checkpoint import flat, part
from training.exchange.facts import WindowFacts, plain
from training.exchange.packing import PackedSender, packing
from training.exchange.reception import Heard, Reception

if TYPE_CHECKING:
    from training.aggregation.aggregator import Aggregator

Weights = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Exchanged:
    """What a window's exchange came to.

    Attributes:
        model: what robots hold after it: all the same, shape (2, P), or each its own, (K, 2, P).
        payload: what is sent to them for that.
    """

    model: Weights
    payload: Payload


class Federation:
    """Combines the robots' weights, window by window.

    Args:
        config: the run's configuration.
        aggregator: its strategy.
    """

    def __init__(self, config: Config, aggregator: Aggregator) -> None:
        self._aggregator, self._reception = aggregator, Reception(config)
        self._up, self._down = packing(config, robot_network(config).parameters)
        self._sender = None if self._down is None else PackedSender(self._down)

    def exchange(
        self, window: int, model: Weights, uploads: Payload, facts: WindowFacts
    ) -> Exchanged:
        """Combines the uploads of a window.

        Args:
            window: the window's number, from 1 over the whole run.
            model: what robots started the window from, shape (2, P) or (K, 2, P).
            uploads: of all K robots, plain or packed.
            facts: of the window.

        Raises:
            ValueError: an upload is absurd; the message names the robot.
            ArithmeticError: the result is not finite.
        """
        given = np.broadcast_to(model, (len(uploads), *model.shape[-2:]))
        rows = self._unpacked(given, uploads)
        heard = self._reception.heard(window, given, rows, facts)
        return self._sent(model, self._combined(window, model, heard))

    def _combined(self, window: int, model: Weights, heard: Heard) -> Weights:
        """What robots are to hold; what they held where nobody was heard."""
        if not len(heard.robots):
            return model
        return self._aggregator.aggregate(window, model, heard.rows)

    def _unpacked(self, given: Weights, uploads: Payload) -> Weights:
        """The robots' weights, shape (K, 2, P)."""
        if self._up is None:
            return plain(uploads)
        pairs = zip(given, uploads, strict=True)
        return np.stack([self._up.added(each, packed) for each, packed in pairs])

    def _sent(self, before: Weights, model: Weights) -> Exchanged:
        """A new model, as robots get it that hold ``before``."""
        if self._sender is None or self._down is None:
            return Exchanged(model, model)
        payload = self._sender.send(before, model)
        return Exchanged(self._down.added(before, payload), payload)

    def uploads(self) -> dict[str, int]:
        """How many uploads so far were heard, late, lost and not asked for."""
        return self._reception.counts()

    def state(self) -> dict[str, NDArray[Any]]:
        """All that it keeps between windows."""
        sender = {} if self._sender is None else self._sender.state()
        return flat(
            {
                "strategy": self._aggregator.state(),
                "sender": sender,
                "reception": self._reception.state(),
            }
        )

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave."""
        self._aggregator.restore(part(state, "strategy"))
        self._reception.restore(part(state, "reception"))
        if self._sender is not None:
            self._sender.restore(part(state, "sender"))


def build_federation(config: Config) -> Federation | None:
    """Makes the federation of a run, or None where each robot keeps its own weights."""
    aggregator = build_aggregator(config.strategy, config.env.robots, partial=True)
    return None if aggregator is None else Federation(config, aggregator)
