"""The server's side of the exchange of weights: from uploads to what robots go on from.

One window after the other: uploads are unpacked, those that were heard are combined, and what
robots take is packed. By default all is heard, a Flower strategy combines, and one model is sent to
everybody as it is.
"""

from __future__ import annotations

from collections.abc import Mapping
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


class Federation:
    """Combines the robots' weights, window by window.

    Attributes:
        airtime: what exchanges have taken of the access point's channel so far, where it has part.
    """

    def __init__(self, config: Config, combiner: Combiner) -> None:
        self._combiner, self._reception = combiner, Reception(config)
        self._up, self._down = packing(config, robot_network(config).parameters)
        self._sender = None if self._down is None else PackedSender(self._down)
        self.airtime = None if config.strategy.name == "gossip" else Airtime(config)
        parts: dict[str, Combiner | Reception | PackedSender | Airtime | None] = {
            "combiner": combiner,
            "reception": self._reception,
            "sender": self._sender,
            "airtime": self.airtime,
        }
        self._parts = {name: each for name, each in parts.items() if each is not None}

    def exchange(
        self, window: int, model: Weights, uploads: Payload, facts: WindowFacts
    ) -> tuple[Weights, Payload]:
        """Combines the uploads of a window.

        Args:
            window: the window's number, from 1 over the whole run.
            model: what robots started the window from, shape (2, P) or (K, 2, P).
            uploads: of all K robots, plain or packed.
            facts: of the window.

        Returns:
            What robots hold after it: all the same, shape (2, P), or each its own, (K, 2, P); and
            what is sent to them for that.

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
        found = model  # where nobody was heard, robots are to hold what they held
        if len(heard.robots):
            found = self._combiner.combine(window, given, heard, facts)
        if self._sender is None or self._down is None:
            return found, found
        payload = self._sender.send(model, found)
        return self._down.added(model, payload), payload

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

    def uploads(self) -> dict[str, int]:
        """How many uploads so far were heard, late, lost and not asked for."""
        return self._reception.counts()

    def state(self) -> dict[str, NDArray[Any]]:
        """All that it keeps between windows."""
        return flat({name: each.state() for name, each in self._parts.items()})

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave."""
        for name, each in self._parts.items():
            each.restore(part(state, name))


def build_federation(config: Config) -> Federation | None:
    """Makes the federation of a run, or None where each robot keeps its own weights."""
    combiner = build_combiner(config)
    return None if combiner is None else Federation(config, combiner)
