"""A robot's side of the exchange of weights: what it sends, and what it makes of what it gets.

By default a robot sends its networks as they are. Options change that on the robot itself, where
nobody else sees what it held: an attacker sends something else, local differential privacy clips
and adds noise, compression packs the difference from the model that the robot was given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from conf import Config
from lockstep import Payload
from training.checkpoint import flat, part
from training.exchange.attacks import attack_of
from training.exchange.packing import PackedSender, packing
from training.exchange.privacy import LocalPrivacy

Weights = NDArray[np.float32]
State = dict[str, NDArray[Any]]


class Change(Protocol):
    """Something that one robot does to its weights before they leave it."""

    def __call__(self, window: int, given: Weights, weights: Weights) -> Weights:
        """What the robot sends instead.

        Args:
            window: the window's number, from 1.
            given: what the robot started the window from, shape (2, P).
            weights: what it has now, likewise.
        """
        ...

    def state(self) -> State:
        """What it keeps between windows."""
        ...

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave; nothing is a fresh one."""
        ...


class Outbox:
    """What one robot sends of its weights, and takes."""

    def __init__(self, config: Config, robot: int, parameters: int) -> None:
        self._changes: dict[str, Change] = dict(changes_of(config, robot))
        up, self._down = packing(config, parameters)
        self._sender = None if up is None else PackedSender(up)
        self._given: Weights = np.zeros((2, parameters), np.float32)

    def send(self, window: int, weights: Weights) -> Payload:
        """The robot's upload of a window: plain, shape (2, P), or packed bytes.

        Args:
            window: the window's number.
            weights: what the robot has, shape (2, P).
        """
        for change in self._changes.values():
            weights = change(window, self._given, weights)
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
        parts = {name: change.state() for name, change in self._changes.items()}
        if self._sender is not None:
            parts["sender"] = self._sender.state()
        return {"given": self._given, **flat(parts)}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave."""
        self._given = np.array(state["given"], np.float32)
        for name, change in self._changes.items():
            change.restore(part(state, name))
        if self._sender is not None:
            self._sender.restore(part(state, "sender"))


def changes_of(config: Config, robot: int) -> list[tuple[str, Change]]:
    """What a robot does to its weights before they leave it, in order."""
    attack = attack_of(config, robot)
    if attack is not None:  # whoever is hostile does not keep to the rules of privacy
        return [("attack", attack)]
    if config.strategy.dp.name == "local":
        return [("privacy", LocalPrivacy(config, robot))]
    return []


def outboxes(config: Config, robots: Sequence[int], parameters: int) -> list[Outbox]:
    """An outbox for each of some robots; none where all send their networks as they are."""
    plain = packing(config, parameters) == (None, None)
    if plain and not any(changes_of(config, robot) for robot in range(config.env.robots)):
        return []
    return [Outbox(config, robot, parameters) for robot in robots]
