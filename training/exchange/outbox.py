"""A robot's side of the exchange of weights: what it sends, and what it makes of what it gets.

By default a robot sends its networks as they are. Options change that on the robot itself, where
nobody else sees what it held: an attacker sends something else, local differential privacy clips
and adds noise, compression packs the difference from the model that the robot was given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conf import Config
from lockstep import Payload
from training.checkpoint import flat, part
from training.exchange.attacks import Stale, attack_of
from training.exchange.packing import PackedSender, packing
from training.exchange.privacy import LocalPrivacy

Weights = NDArray[np.float32]
State = dict[str, NDArray[Any]]


Change = Callable[[int, Weights, Weights], Weights]
"""What a robot sends instead of its weights.

From the number of the window, what the robot started it from, and what it has now: shape (2, P).
"""


class Outbox:
    """What one robot sends of its weights, and takes."""

    def __init__(self, config: Config, robot: int, parameters: int) -> None:
        self._change = change_of(config, robot)
        up, self._down = packing(config, parameters)
        self._sender = None if up is None else PackedSender(up)
        self._given: Weights = np.zeros((2, parameters), np.float32)

    def send(self, window: int, weights: Weights) -> Payload:
        """The robot's upload of a window from its weights: plain, shape (2, P), or packed bytes."""
        if self._change is not None:
            weights = self._change(window, self._given, weights)
        if self._sender is None:
            return weights
        return self._sender.send(self._given, weights)

    def take(self, received: Payload) -> Weights:
        """The networks that the robot goes on from, shape (2, P), of a plain or packed model."""
        if received.dtype == np.uint8:
            assert self._down is not None  # the link has checked what is due
            self._given = self._down.added(self._given, received)
        else:
            self._given = np.array(received, np.float32)
        return self._given

    def state(self) -> State:
        """All that the robot needs beside its agent to go on from the end of a window."""
        state: State = {"given": self._given}
        if isinstance(self._change, Stale) and self._change.first is not None:
            state["attack/first"] = self._change.first
        if self._sender is not None:
            state |= flat({"sender": self._sender.state()})
        return state

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave."""
        self._given = np.array(state["given"], np.float32)
        if isinstance(self._change, Stale):
            self._change.first = state.get("attack/first")
        if self._sender is not None:
            self._sender.restore(part(state, "sender"))


def change_of(config: Config, robot: int) -> Change | None:
    """What a robot does to its weights before they leave it; None: nothing.

    Whoever is hostile does not keep to the rules of privacy.
    """
    attack = attack_of(config, robot)
    if attack is None and config.strategy.dp.name == "local":
        return LocalPrivacy(config, robot)
    return attack


def outboxes(config: Config, robots: Sequence[int], parameters: int) -> list[Outbox]:
    """An outbox for each of some robots; none where all send their networks as they are."""
    plain = packing(config, parameters) == (None, None)
    if plain and not any(change_of(config, robot) for robot in range(config.env.robots)):
        return []
    return [Outbox(config, robot, parameters) for robot in robots]
