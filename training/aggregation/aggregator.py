"""Federated aggregation: one call into a Flower ``Strategy`` per window, the same in every runtime.

The weights have travelled already, in Flower messages or over the link. What happens here is
Flower's server side of one round, within this process: ``configure_train`` addresses K virtual
nodes, node k answers with robot k's weights, and ``aggregate_train`` takes the replies in the order
of the robots, however they arrived.

Flower's mean is sum_k w_k x_k with w_k = n_k / sum_j n_j, added in the order of the replies.
Robots count alike (n_k = 1, so w_k = 1/K). In float32 equal uploads would come back changed, by
up to 1 ulp for 3 robots and 9 for 33 (measured), since 1/K and each partial sum are rounded. So
weights go in as float64, which holds each float32 exactly, and results are rounded to float32 once:
equal uploads come back bit for bit, and any other mean is a float32 nearest to the exact one (of
two as near, either). Krum's squared distances, ||x||^2 + ||y||^2 - 2xy, need float64 too: robots
differ by little beside their norms.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import numpy as np
import numpy.typing as npt
from flwr.serverapp.strategy import FedAvg, Strategy

from repeatable.isolation import within_flower
from repeatable.kept import Kept
from training.aggregation.flower_round import WeightRows, one_round
from training.aggregation.privacy import averaging, drawing_from
from training.aggregation.uploads import check_uploads

ONLINE, TARGET = slice(0, 1), slice(1, 2)
"""The rows of a robot's weights, shape (2, P)."""


class Aggregator:
    """A Flower strategy, applied to the weights of all robots once per window.

    Uploads are ordered by robot, so the order in which they arrived cannot matter. No call changes
    the state of a global random generator or lets Flower log anything below an error.
    """

    def __init__(
        self,
        strategy: Strategy,
        robots: int,
        *,
        online: bool = False,
        who: str = "robot",
        partial: bool = False,
        noise: Callable[[int], np.random.Generator] | None = None,
    ) -> None:
        """Takes a strategy over.

        Args:
            strategy: a fresh strategy. It is the aggregator's from here on, and all who upload take
                part in each window: FedAvg's and its kin's sampling settings are overwritten. One
                of another kind may ask fewer.
            robots: K, at least 1.
            online: whether the strategy is applied to online weights alone, and targets take the
                plain mean, as server optimisers (momentum, Adam) need; else to both together.
            who: what uploads, for messages.
            partial: whether fewer than ``robots`` may upload.
            noise: the generator of a window, for a strategy that draws from NumPy's global one.
        """
        if robots < 1:
            raise ValueError(f"{robots} {who}s: at least 1 is needed")
        self._strategy, self._robots = strategy, robots
        self._who, self._partial, self._noise = who, partial, noise
        self._parts: list[tuple[Strategy, slice]] = [(strategy, slice(None))]
        if online:
            self._parts = [(strategy, ONLINE), (FedAvg(), TARGET)]
        self._expect(robots)
        self._kept = Kept(strategy)
        self.restore({})  # as after a resume, in which no two attributes share an array

    def aggregate(self, window: int, current: WeightRows, uploads: WeightRows) -> WeightRows:
        """Aggregates one window.

        Args:
            window: the window's number, from 1 over the whole run (FedAdam reads it).
            current: what all robots started the window from, shape (2, P): online, target.
            uploads: what the robots have now, shape (K, 2, P), row k for robot k; with ``partial``
                those of fewer.

        Returns:
            The weights that every robot takes, float32, shape (2, P), owned by the caller.

        Raises:
            ValueError: a shape or the window is wrong, or an upload is not finite or beyond
                ``WEIGHT_LIMIT``; the message names the robot and the value.
            ArithmeticError: the strategy's result is not finite in float32.
        """
        self._check(window, current, uploads)
        self._expect(len(uploads))
        draws = nullcontext() if self._noise is None else drawing_from(self._noise(window))
        with within_flower(), draws:
            results = [
                one_round(part, window, current[rows], uploads[:, rows])
                for part, rows in self._parts
            ]
        with np.errstate(over="ignore"):
            combined = np.concatenate(results).astype(np.float32)
        if not np.isfinite(combined).all():
            name = type(self._strategy).__name__
            raise ArithmeticError(f"{name} gave weights that are not finite in window {window}")
        return combined

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """What the strategy keeps between windows, as copies; empty where it keeps nothing."""
        return self._kept.state()

    def restore(self, state: dict[str, npt.NDArray[Any]]) -> None:
        """Puts back what ``state`` gave, exactly; ``{}`` is a fresh strategy.

        Raises:
            ValueError: the state is another strategy's.
        """
        self._kept.restore(state)

    def _expect(self, count: int) -> None:
        """Lets the strategy wait for so many, all of whom take part."""
        for part, _ in self._parts:
            if isinstance(mean := averaging(part, count), FedAvg):
                mean.fraction_train = 1.0
                mean.min_train_nodes = mean.min_available_nodes = count

    def _check(self, window: int, current: WeightRows, uploads: WeightRows) -> None:
        if window < 1:
            raise ValueError(f"window {window}: windows are numbered from 1")
        fewer = self._partial and 1 <= len(uploads) <= self._robots
        expected = (len(uploads) if fewer else self._robots, *current.shape)
        if current.ndim != 2 or current.shape[0] != 2 or uploads.shape != expected:
            raise ValueError(
                f"weights of shape {current.shape} and uploads of shape {uploads.shape}:"
                f" (2, P) and ({self._robots}, 2, P) are expected"
            )
        check_uploads(window, uploads, self._who)
