"""The network: how a multilayer perceptron lies in one flat row, and the forward used to act.

A row holds, layer after layer, the weight matrix [inputs, outputs] and then the bias
[outputs]. The bias is thus one further row of its matrix, which the learner uses: an input
with a constant 1 appended needs one product for both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import torch

FloatArray = NDArray[np.float32]
Rows = TypeVar("Rows", FloatArray, "torch.Tensor")


@dataclass(frozen=True)
class NetworkShape:
    """Sizes of a multilayer perceptron with ReLU between its layers."""

    inputs: int
    hidden: tuple[int, ...]
    actions: int

    @property
    def layers(self) -> list[tuple[int, int]]:
        """(inputs, outputs) of each layer, first to last."""
        return list(pairwise((self.inputs, *self.hidden, self.actions)))

    @property
    def parameters(self) -> int:
        """P, the length of a network's flat row."""
        return sum((inputs + 1) * outputs for inputs, outputs in self.layers)

    def matrices(self, flat: Rows) -> list[Rows]:
        """Each layer's weights with the bias as last row, of rows of shape (..., P).

        Returns:
            Views of shape (..., inputs + 1, outputs), one per layer.
        """
        found, at = [], 0
        for inputs, outputs in self.layers:
            size = (inputs + 1) * outputs
            part = flat[..., at : at + size]
            found.append(part.reshape(*flat.shape[:-1], inputs + 1, outputs))
            at += size
        return found

    def views(self, flat: Rows) -> list[tuple[Rows, Rows]]:
        """Each layer's weights and bias, of rows of shape (..., P).

        Returns:
            Views (W, b) of shapes (..., inputs, outputs) and (..., outputs), one pair per layer.
        """
        return [(matrix[..., :-1, :], matrix[..., -1, :]) for matrix in self.matrices(flat)]

    def initial_weights(self, generator: np.random.Generator) -> FloatArray:
        """Draws a row, (P,), as ``torch.nn.Linear`` does: U(-1/sqrt(inputs), 1/sqrt(inputs))."""
        flat = np.empty((1, self.parameters), np.float32)
        for matrix in self.matrices(flat):
            bound = 1 / np.sqrt(matrix.shape[1] - 1)
            matrix[:] = generator.uniform(-bound, bound, matrix.shape)
        row: FloatArray = flat[0]
        return row

    def initial_pair(self, generator: np.random.Generator) -> FloatArray:
        """``initial_weights`` as online and target network, shape (2, P)."""
        return np.stack([self.initial_weights(generator)] * 2)


def q_values(shape: NetworkShape, weights: FloatArray, observations: FloatArray) -> FloatArray:
    """Action values Q(s, a) of several networks, each on its own observations; (n, B, actions).

    Everything that acts or evaluates goes through here, so that the last bits agree. A network
    gives the same bits whether others stand beside it or not.

    Args:
        shape: sizes of the networks.
        weights: the networks' rows, shape (n, P).
        observations: shape (n, B, inputs).
    """
    return forward(shape.views(weights), observations)


def forward(
    layers: Sequence[tuple[FloatArray, FloatArray]], observations: FloatArray
) -> FloatArray:
    """The same as `q_values`, on views that the caller has kept: what `NetworkShape.views` gave."""
    x = observations
    last = len(layers) - 1
    for depth, (weight, bias) in enumerate(layers):
        x = np.matmul(x, weight)
        x += bias[:, None]
        if depth < last:
            np.maximum(x, 0, out=x)
    return x
