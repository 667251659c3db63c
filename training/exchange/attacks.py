"""Robots that upload something else than what they have learned.

Hostile are the last ``attack.robots`` robots. They drive, learn and take the common model as the
others do, and only their uploads are false. None sends weights beyond ``WEIGHT_LIMIT``, which the
server would refuse by the robot's name.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.networks.limits import WEIGHT_LIMIT
from conf import Config
from env.config import MAX_ROBOTS
from env.seeding import Stream, stream

Weights = NDArray[np.float32]


class FalseStep:
    """What all attacks have in common that need not remember anything.

    Args:
        config: the run's configuration.
        robot: the hostile one.
    """

    def __init__(self, config: Config, robot: int) -> None:
        self._seed, self._robot = config.seed, robot
        self._scale = np.float32(config.attack.scale)

    def __call__(self, window: int, given: Weights, weights: Weights) -> Weights:
        """See ``Change``."""
        false = given + self._scale * self._step(window, weights - given)
        return np.clip(false, -WEIGHT_LIMIT, WEIGHT_LIMIT).astype(np.float32)

    def _step(self, window: int, honest: Weights) -> Weights:
        """A step in place of the honest one, both of shape (2, P)."""
        raise NotImplementedError

    def state(self) -> dict[str, NDArray[Any]]:
        """See ``Change``: nothing."""
        return {}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """See ``Change``."""


class Noise(FalseStep):
    """A Gaussian step, for each network about as long as the honest one."""

    def _step(self, window: int, honest: Weights) -> Weights:
        rng = stream(self._seed, Stream.ATTACK, window * MAX_ROBOTS + self._robot)
        size: Weights = np.sqrt(np.mean(np.square(honest), axis=1, keepdims=True))
        return size * rng.standard_normal(honest.shape, np.float32)


class Flip(FalseStep):
    """The honest step with its sign flipped."""

    def _step(self, window: int, honest: Weights) -> Weights:
        return -honest


class Scale(FalseStep):
    """The honest step, made longer."""

    def _step(self, window: int, honest: Weights) -> Weights:
        return honest


class Stale:
    """What the robot sent in its first window, for ever."""

    def __init__(self, config: Config, robot: int) -> None:
        self._first: Weights | None = None

    def __call__(self, window: int, given: Weights, weights: Weights) -> Weights:
        """See ``Change``."""
        if self._first is None:
            self._first = np.array(weights)
        return self._first

    def state(self) -> dict[str, NDArray[Any]]:
        """See ``Change``: what was sent first."""
        return {} if self._first is None else {"first": self._first}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """See ``Change``."""
        first = state.get("first")
        self._first = None if first is None else np.array(first, np.float32)


ATTACKS: dict[str, type[FalseStep] | type[Stale]] = {
    "noise": Noise,
    "flip": Flip,
    "scale": Scale,
    "stale": Stale,
}
"""By ``attack.name``."""


def attack_of(config: Config, robot: int) -> FalseStep | Stale | None:
    """What a robot does to its uploads; None where it is honest."""
    if robot < config.env.robots - config.attack.robots:
        return None
    return ATTACKS[config.attack.name](config, robot)
