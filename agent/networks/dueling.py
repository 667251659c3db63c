"""The dueling head: a network's outputs made action values, and the way back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_FloatArray = NDArray[np.float32]


@dataclass(frozen=True)
class DuelingHead:
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
        """Of the last layer."""
        return self.actions + 1

    def action_values(self, outputs: _FloatArray, axis: int) -> _FloatArray:
        """Q(s, a) of every action.

        Args:
            outputs: of the last layer, along `axis`.
            axis: of the outputs, and of the actions.

        Returns:
            An array of its own, with the actions along `axis`.
        """
        advantages, value = np.split(outputs, [-1], axis=axis)
        mean = np.add.reduce(advantages, axis=axis, keepdims=True)
        mean *= np.float32(1 / self.actions)
        values: _FloatArray = advantages + (value - mean)
        return values

    def backward(self, grad: _FloatArray, out: _FloatArray) -> None:
        """The loss's gradient at the outputs, from its gradient at the action values.

        Args:
            grad: shape (n, actions, B).
            out: to fill, shape (n, outputs, B).
        """
        np.add.reduce(grad, axis=1, out=out[:, -1])
        share = out[:, -1] * np.float32(1 / self.actions)
        np.subtract(grad, share[:, None], out=out[:, :-1])
