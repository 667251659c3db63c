"""One gradient step's arithmetic for agents that stand side by side, by hand.

Activations are feature-major, [n, features + 1, B]: the batch is the contiguous axis, so every
product has full vector width, and the best action is found by element-wise maxima. The last
feature is a constant 1 that meets the bias row of the weights. The forward of s with the online
network and that of s' with the target are one stacked product.

Small products run in NumPy, which has the lower cost per call; large ones in torch, whose
library is faster (measured with 2 x 64 and 2 x 128 units). Which one is a matter of a layer's
size alone and each product is one agent's, so an agent's bits do not depend on its neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch

from agent.config import AgentConfig
from agent.learning.buffers import Workspace
from agent.learning.losses import double_dqn_values, dqn_values, huber, td_target
from agent.networks.mlp import FloatArray, NetworkShape
from agent.replay import RowLayout

_TORCH_FROM = 1 << 20  # multiply-adds of a product that torch does sooner than NumPy ...
_TORCH_GRADIENT_FROM = 1 << 17  # ... and of one that sums over the batch
_FLOAT_BYTES = 4
_relu_backward = torch.ops.aten.threshold_backward.grad_input

Step = Callable[[], object]


class Forward:
    """The forward of stacked networks on feature-major inputs.

    Attributes:
        activations: what each layer reads, a constant 1 last; shapes
            (n, passes, features + 1, B).
        inputs: the first layer's part to fill, shape (n, passes, inputs, B).
        q: the result, shape (n, passes, actions, B).
    """

    def __init__(
        self, shape: NetworkShape, weights: torch.Tensor, layers: list[torch.Tensor]
    ) -> None:
        """Plans the forward of networks whose rows are `weights`, shape (n, passes, P).

        Args:
            shape: of the networks.
            weights: their rows.
            layers: buffers for at least n agents.
        """
        *self.activations, q = (layer[: len(weights)] for layer in layers)
        self.inputs: FloatArray = self.activations[0][:, :, :-1].numpy()
        self.q: FloatArray = q.numpy()
        self._steps: list[Step] = []
        outputs = [*(activation[:, :, :-1] for activation in self.activations[1:]), q]
        for matrix, activation, output in zip(
            shape.matrices(weights), self.activations, outputs, strict=True
        ):
            self._steps.append(_product(matrix.mT, activation, output, _TORCH_FROM))
            if output is not q:
                self._steps.append(partial(torch.relu_, output))

    def run(self) -> None:
        """Computes `q` from `inputs`."""
        for step in self._steps:
            step()


class Backward:
    """The way back through stacked networks, from the loss's slope at their results.

    Attributes:
        grad: to fill, shape (n, actions, B).
    """

    def __init__(
        self,
        shape: NetworkShape,
        online: torch.Tensor,
        gradient: torch.Tensor,
        activations: Sequence[torch.Tensor],
        grads: Sequence[torch.Tensor],
    ) -> None:
        """Plans the steps from the last layer to the first.

        Args:
            shape: of the networks.
            online: their rows, shape (n, P).
            gradient: where theirs goes, shape (n, P).
            activations: of their forward, whose first pass is that of `online`.
            grads: buffers for at least n agents.
        """
        grads = [grad[: len(online)] for grad in grads]
        weights, gradients = shape.matrices(online), shape.matrices(gradient)
        self.grad: FloatArray = grads[-1].numpy()
        self._steps: list[Step] = []
        for depth in reversed(range(len(grads))):
            read, grad = activations[depth][:, 0], grads[depth]
            self._steps.append(_product(read, grad.mT, gradients[depth], _TORCH_GRADIENT_FROM))
            if depth > 0:
                before, hidden = grads[depth - 1], read[:, :-1]
                self._steps.append(_product(weights[depth][:, :-1], grad, before, _TORCH_FROM))
                self._steps.append(partial(_relu_backward, before, hidden, 0, grad_input=before))

    def run(self) -> None:
        """Computes the gradient from `grad`."""
        for step in self._steps:
            step()


class GradientStep:
    """Neighbouring agents that learn together: their views and steps, planned once."""

    def __init__(
        self,
        shape: NetworkShape,
        config: AgentConfig,
        discount: float,
        weights: torch.Tensor,
        gradient: torch.Tensor,
        batch: FloatArray,
        scratch: Workspace,
    ) -> None:
        """Plans a gradient step.

        Args:
            shape: of the networks.
            config: how they learn.
            discount: of these agents; 0 spares the next states' forward.
            weights: their online and target networks, shape (n, 2, P).
            gradient: where the online networks' gradient goes, shape (n, P).
            batch: where their sampled transitions will stand, shape (n, B, row width).
            scratch: buffers for at least n agents.
        """
        agents, size = batch.shape[:2]
        passes = 2 if discount else 1
        self._config, self._discount = config, discount
        self._layout, self._batch, self._size = RowLayout(shape.inputs), batch, size
        states = batch[:, :, : passes * shape.inputs]
        self._states = states.reshape(agents, size, passes, shape.inputs).transpose(0, 2, 3, 1)
        self._forward = Forward(shape, weights[:, :passes], scratch.layers)
        self._chooser = None
        if scratch.chooser is not None:
            self._chooser = Forward(shape, weights[:, :1], scratch.chooser)
        read = self._forward.activations
        self._backward = Backward(shape, weights[:, 0], gradient, read, scratch.grads)
        self._flat_q, self._q_at = _flat(self._forward.q)
        self._flat_grad, self._grad_at = _flat(self._backward.grad)

    def run(self) -> FloatArray:
        """Computes the gradient on the batch that stands in its place.

        Returns:
            Each agent's mean loss, shape (n,).
        """
        self._run_forward()
        action = self._batch[:, :, self._layout.action].astype(np.intp)
        action *= self._size
        error = self._flat_q.take(action + self._q_at)
        error -= self._targets()
        losses, grad = huber(error, self._config.huber_delta)
        grad *= 1 / self._size
        self._flat_grad.fill(0)
        self._flat_grad[action + self._grad_at] = grad
        self._backward.run()
        mean: FloatArray = np.add.reduce(losses, axis=1)
        mean *= 1 / self._size
        return mean

    def _run_forward(self) -> None:
        """Values of s by the online network and of s' by the target, in `_forward.q`."""
        np.copyto(self._forward.inputs, self._states)
        self._forward.run()

    def _next_online_q(self) -> FloatArray | None:
        """Values of s' by the online network, by which double DQN chooses; None without it."""
        if self._chooser is None:
            return None
        self._chooser.inputs[:, 0] = self._forward.inputs[:, 1]
        self._chooser.run()
        return self._chooser.q[:, 0]

    def _targets(self) -> FloatArray:
        """TD targets of the batch, shape (n, B)."""
        rewards = self._batch[:, :, self._layout.reward]
        if not self._discount:
            return rewards
        target_q, by = self._forward.q[:, 1], self._next_online_q()
        values = dqn_values(target_q) if by is None else double_dqn_values(by, target_q)
        terminal = self._batch[:, :, self._layout.terminal]
        return td_target(rewards, terminal, values, self._discount)


def _product(left: torch.Tensor, right: torch.Tensor, out: torch.Tensor, torch_from: int) -> Step:
    """Plans ``out = left @ right`` for stacks of matrices that keep their places."""
    rows, inner, columns = *left.shape[-2:], right.shape[-1]
    if rows * inner * columns < torch_from:
        return partial(np.matmul, left.numpy(), right.numpy(), out=out.numpy())
    stack = out.shape[:-2]
    parts = [(left[at], right[at], out[at]) for at in np.ndindex(*stack)]

    def one_by_one() -> None:
        for a, b, c in parts:
            torch.mm(a, b, out=c)

    return one_by_one


def _flat(part: FloatArray) -> tuple[FloatArray, np.ndarray[tuple[int, int], np.dtype[np.intp]]]:
    """Agents' (..., B) parts as one flat view, and the place of each sample's first feature.

    Returns:
        The view, padding included, and places of shape (n, B).
    """
    stride = part.strides[0] // _FLOAT_BYTES
    flat = np.lib.stride_tricks.as_strided(part, (part.shape[0] * stride,), (_FLOAT_BYTES,))
    first = np.arange(part.shape[0])[:, None] * stride
    return flat, first + np.arange(part.shape[-1])
