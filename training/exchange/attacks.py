"""Robots that upload something else than what they have learned.

Hostile are the last ``attack.robots`` robots. They drive, learn and take the common model as the
others do, and only their uploads are false. None sends weights beyond ``WEIGHT_LIMIT``, which the
server would refuse by the robot's name.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.networks.limits import WEIGHT_LIMIT
from conf import Config
from env.config import MAX_ROBOTS
from env.seeding import Stream, stream

Weights = NDArray[np.float32]


class FalseStep:
    """A step in place of the honest one, by ``attack.name``, ``attack.scale`` times as long.

    ``noise``: Gaussian, for each network about as long as the honest one; ``flip``: that with its
    sign flipped; ``scale``: the honest one.
    """

    def __init__(self, config: Config, robot: int) -> None:
        self._name, self._seed, self._robot = config.attack.name, config.seed, robot
        self._scale = np.float32(config.attack.scale)

    def __call__(self, window: int, given: Weights, weights: Weights) -> Weights:
        """See ``Change``."""
        step = weights - given
        if self._name == "noise":
            rng = stream(self._seed, Stream.ATTACK, window * MAX_ROBOTS + self._robot)
            size: Weights = np.sqrt(np.mean(np.square(step), axis=1, keepdims=True))
            step = size * rng.standard_normal(step.shape, np.float32)
        elif self._name == "flip":
            step = -step
        elif self._name != "scale":
            raise ValueError(f"attack.name={self._name} has no step of its own")
        false = given + self._scale * step
        return np.clip(false, -WEIGHT_LIMIT, WEIGHT_LIMIT).astype(np.float32)


class Stale:
    """What the robot sent in its first window, for ever.

    Attributes:
        first: that, shape (2, P); None before.
    """

    def __init__(self) -> None:
        self.first: Weights | None = None

    def __call__(self, window: int, given: Weights, weights: Weights) -> Weights:
        """See ``Change``."""
        if self.first is None:
            self.first = np.array(weights)
        return self.first


def attack_of(config: Config, robot: int) -> FalseStep | Stale | None:
    """What a robot does to its uploads; None where it is honest."""
    if robot < config.env.robots - config.attack.robots:
        return None
    return Stale() if config.attack.name == "stale" else FalseStep(config, robot)
