"""Local differential privacy: a robot clips its step and adds noise before anything leaves it.

The arithmetic is that of Flower's ``LocalDpMod``; noise is drawn from the run's own streams.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conf import Config
from env.seeding import Stream, stream

Weights = NDArray[np.float32]


class LocalPrivacy:
    """What one robot does to its networks; see ``training.exchange.outbox.Change``.

    Where target networks are copied from the online ones, those alone are sent, clipped and noised.
    """

    def __init__(self, config: Config, robot: int) -> None:
        dp = config.strategy.dp
        self._seed, self._robot, self._robots = config.seed, robot, config.env.robots
        self._clip, self._deviation = dp.clip, dp.noise * dp.clip
        self._sent = slice(None if config.federation.compression.targets == "averaged" else 1)

    def __call__(self, window: int, given: Weights, weights: Weights) -> Weights:
        """The given networks, the clipped step from them, and noise; shape (2, P)."""
        start = given[self._sent].astype(np.float64)
        step = clipped(weights[self._sent] - start, self._clip)
        index = (window - 1) * self._robots + self._robot
        noise = stream(self._seed, Stream.LOCAL_NOISE, index).normal(0, self._deviation, step.shape)
        found = weights.copy()
        found[self._sent] = start + step + noise
        return found


def clipped(step: NDArray[np.float64], clip: float) -> NDArray[np.float64]:
    """A step of any shape, shortened to a norm of at most ``clip``."""
    norm = float(np.linalg.norm(step))
    return step * (clip / norm) if norm > clip else step
