"""The server's side of the exchange of weights: from uploads to what robots go on from.

One window after the other: uploads are unpacked, those that were heard are combined, and what
robots take is packed. By default all is heard, a Flower strategy combines, and one model is sent to
everybody as it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conf import Config, robot_network
from lockstep import Payload
from training.aggregation.uploads import check_uploads
from training.checkpoint import flat, part
from training.exchange.airtime import Airtime
from training.exchange.combining import Combiner, build_combiner
from training.exchange.facts import WindowFacts, plain
from training.exchange.packing import PackedSender, packing
from training.exchange.reception import Reception

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
        combiner: of its strategy.

    Attributes:
        airtime: what exchanges have taken of the access point's channel so far, where it has part.
    """

    def __init__(self, config: Config, combiner: Combiner) -> None:
        self._combiner, self._reception = combiner, Reception(config)
        self._up, self._down = packing(config, robot_network(config).parameters)
        self._sender = None if self._down is None else PackedSender(self._down)
        self.airtime = None if config.strategy.name == "gossip" else Airtime(config)

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
        check_uploads(window, heard.rows, robots=heard.robots)
        if self.airtime is not None:
            self.airtime.add(facts, heard.asked)
        # where nobody was heard, robots are to hold what they held
        heard_any = len(heard.robots) > 0
        found = self._combiner.combine(window, given, heard, facts) if heard_any else model
        return self._sent(model, found)

    def observed(self, updates: np.ndarray) -> None:
        """Takes notice of the records that robots are sent in a step, shape (K E,)."""
        self._combiner.observed(updates)

    def _unpacked(self, given: Weights, uploads: Payload) -> Weights:
        """The robots' weights, shape (K, 2, P)."""
        if self._up is None:
            return plain(uploads)
        rows = []
        for robot, (each, packed) in enumerate(zip(given, uploads, strict=True)):
            try:
                rows.append(self._up.added(each, packed))
            except ValueError as error:
                raise ValueError(f"packed weights of robot {robot}: {error}") from error
        return np.stack(rows)

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
                "combiner": self._combiner.state(),
                "sender": sender,
                "reception": self._reception.state(),
                "airtime": {} if self.airtime is None else self.airtime.state(),
            }
        )

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave."""
        self._combiner.restore(part(state, "combiner"))
        self._reception.restore(part(state, "reception"))
        if self.airtime is not None:
            self.airtime.restore(part(state, "airtime"))
        if self._sender is not None:
            self._sender.restore(part(state, "sender"))


def build_federation(config: Config) -> Federation | None:
    """Makes the federation of a run, or None where each robot keeps its own weights."""
    combiner = build_combiner(config)
    return None if combiner is None else Federation(config, combiner)
