"""How a network's outputs become values of actions, and the way back, where one is not the other.

Outputs lie one after the other along an axis, and so do the actions' values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

_FloatArray = NDArray[np.float32]


class Form(Protocol):
    """A linear map from outputs to action values."""

    @property
    def outputs(self) -> int:
        """Of the last layer."""

    def action_values(self, outputs: _FloatArray, axis: int) -> _FloatArray:
        """Q(s, a) of every action.

        Args:
            outputs: of the last layer, along `axis`.
            axis: of the outputs, and of the actions.

        Returns:
            An array of its own, with the actions along `axis`.
        """

    def outputs_slope(self, slope: _FloatArray, out: _FloatArray) -> None:
        """The loss's slope at the outputs, from its slope at the action values.

        Args:
            slope: shape (n, actions, B).
            out: to fill, shape (n, outputs, B).
        """


@dataclass(frozen=True)
class Dueling:
    """A state's value and each action's advantage: Q = V + A - mean of A over the actions.

    Wang et al., "Dueling network architectures for deep reinforcement learning", ICML 2016,
    Eq. (9). Both streams are one linear layer on the shared hidden layers, so they lie in one
    matrix: the advantages first, the value last.

    Attributes:
        actions: how many there are.
    """

    actions: int

    @property
    def outputs(self) -> int:
        """See `Form`."""
        return self.actions + 1

    def action_values(self, outputs: _FloatArray, axis: int) -> _FloatArray:
        """See `Form`."""
        advantages, value = np.split(outputs, [-1], axis=axis)
        mean = np.add.reduce(advantages, axis=axis, keepdims=True)
        mean *= np.float32(1 / self.actions)
        values: _FloatArray = advantages + (value - mean)
        return values

    def outputs_slope(self, slope: _FloatArray, out: _FloatArray) -> None:
        """See `Form`."""
        np.add.reduce(slope, axis=1, out=out[:, -1])
        share = out[:, -1] * np.float32(1 / self.actions)
        np.subtract(slope, share[:, None], out=out[:, :-1])


@dataclass(frozen=True)
class Factored:
    """An action of several choices: its value is the sum of what each choice is worth.

    Tang et al., "Leveraging factored action spaces for efficient offline reinforcement learning in
    healthcare", NeurIPS 2022: a linear decomposition of Q. What is learned of a choice serves every
    action that contains it, at the price that no choice's worth can depend on another's.

    Attributes:
        factors: choices of each part; the action's index counts the last part first.
    """

    factors: tuple[int, ...]

    @property
    def outputs(self) -> int:
        """See `Form`."""
        return sum(self.factors)

    @property
    def actions(self) -> int:
        """How many there are."""
        return math.prod(self.factors)

    def action_values(self, outputs: _FloatArray, axis: int) -> _FloatArray:
        """See `Form`."""
        moved = np.moveaxis(outputs, axis, -1)
        first, *others = np.split(moved, list(accumulate(self.factors))[:-1], axis=-1)
        values: _FloatArray = first.copy()
        for worth in others:
            sums = values[..., :, None] + worth[..., None, :]
            values = sums.reshape(*sums.shape[:-2], -1)
        return np.moveaxis(values, -1, axis)

    def outputs_slope(self, slope: _FloatArray, out: _FloatArray) -> None:
        """See `Form`."""
        n, _, size = slope.shape
        end = 0
        for count, before, after in zip(self.factors, *self._around(), strict=True):
            of_part = slope.reshape(n, before, count, after, size)
            begin, end = end, end + count
            np.add.reduce(np.add.reduce(of_part, axis=3), axis=1, out=out[:, begin:end])

    def _around(self) -> tuple[list[int], list[int]]:
        """The number of actions that the parts before and after each part make."""
        before = [math.prod(self.factors[:part]) for part in range(len(self.factors))]
        after = [math.prod(self.factors[part + 1 :]) for part in range(len(self.factors))]
        return before, after
