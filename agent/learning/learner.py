"""The stacked learner: n agents' weights, gradients and Adam moments in shared rows.

Gradients are computed by hand on stacks of agents (see `agent.learning.gradients`): most of it in
NumPy on the memory of torch tensors, since NumPy's calls cost least and its stacked products are
one agent's each; large products, ReLU and the fused Adam are torch's. Measured against eager torch
it is 9 times faster for 2 x 64 units and 5 times for 2 x 128 (three robots and an access point,
batch 128), and agrees with it to 1e-7 after 200 updates.

An agent's bits do not depend on who stands beside it: its rows start on a cache line, every
product is its own, and Adam takes its row as a tensor of its own with a step count of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray

from agent.config import AgentConfig
from agent.exploration import GREEDY
from agent.learning.buffers import Workspace, aligned_zeros
from agent.learning.gradients import GradientStep
from agent.networks.mlp import FloatArray, NetworkShape, forward
from agent.replay import RowLayout

_BETAS = (0.9, 0.999)
_EPSILON = 1e-8
_MOST_ABREAST = 8
"""Agents in one product: more no longer save anything and outgrow a core's cache (measured)."""


class Learner:
    """Takes gradient steps of n agents on batches that the caller puts in place.

    Attributes:
        weights: online and target networks, shape (n, 2, P).
        moments: Adam's first and second moments, shape (n, 2, P).
        steps: updates each agent has taken, shape (n,).
        proximal_reference: the weights to which FedProx pulls, shape (n, P).
        batch: the sampled transitions' place, shape (n, B, row width).
    """

    _step_type = GradientStep

    def __init__(
        self,
        shape: NetworkShape,
        config: AgentConfig,
        discount: float,
        agents: int,
        proximal_mu: float = 0.0,
        width: int | None = None,
    ) -> None:
        """Reserves the rows of n agents, all zero.

        Args:
            shape: of each agent's network.
            config: how they learn.
            discount: at least 0; 0 spares the forward of next states.
            agents: n.
            proximal_mu: FedProx's mu; 0 leaves the term out.
            width: of a transition's row; that of `RowLayout` if None.
        """
        self._shape, self._config, self._discount = shape, config, discount
        self._mu = proximal_mu
        size = shape.parameters
        self._weights = _rows(agents, 2, size)
        self._moments = _rows(agents, 2, size)
        self._gradient = _rows(agents, 1, size)
        self._steps = aligned_zeros(agents, 1)
        self.weights: FloatArray = self._weights.numpy()
        self.moments: FloatArray = self._moments.numpy()
        self.steps: FloatArray = self._steps[:, 0].numpy()
        self.gradient: FloatArray = self._gradient[:, 0].numpy()
        self.proximal_reference: FloatArray = _rows(agents, 1, size)[:, 0].numpy()
        width = width or RowLayout(shape.inputs).width
        self.batch: FloatArray = aligned_zeros(agents, config.batch_size, width).numpy()
        self._online = list(self._weights[:, 0])
        self._gradients = list(self._gradient[:, 0])
        self._first, self._second = list(self._moments[:, 0]), list(self._moments[:, 1])
        self._step_counts = list(self._steps[:, 0])
        self._layers = shape.views(self.weights[:, 0])
        passes = 2 if discount else 1
        self._scratch = Workspace(shape, config, passes, min(agents, _MOST_ABREAST))
        self._planned: dict[tuple[int, int], GradientStep] = {}

    def update(self, learning: Sequence[bool]) -> FloatArray:
        """Takes one gradient step of the chosen agents on their part of `batch`.

        Args:
            learning: who learns, n of them. The others' rows do not change at all.

        Returns:
            Mean losses, nan for those who do not learn, shape (n,).
        """
        losses = np.full(len(self._online), np.nan, np.float32)
        for start, stop in contiguous_runs(learning, _MOST_ABREAST):
            step = self._planned.get((start, stop))
            if step is None:
                step = self._planned[start, stop] = self._plan(start, stop)
            losses[start:stop] = step.run()
            if self._mu:
                pull = self.weights[start:stop, 0] - self.proximal_reference[start:stop]
                pull *= self._mu
                self.gradient[start:stop] += pull
            self._descend(start, stop)
            if self._config.target.tau is not None:
                self._polyak_update(start, stop, self._config.target.tau)
        return losses

    def copy_to_target(self, agent: int) -> None:
        """Makes an agent's target network equal to its online network."""
        self.weights[agent, 1] = self.weights[agent, 0]

    def choose(self, observations: FloatArray, choices: NDArray[np.int32]) -> None:
        """Puts each agent's best action where its choice is `GREEDY`.

        Args:
            observations: in each of E worlds, shape (n, E, inputs).
            choices: changed in place, shape (n, E).
        """
        greedy = choices == GREEDY
        if greedy.any():
            q = forward(self._layers, observations)
            np.copyto(choices, q.argmax(axis=-1), where=greedy, casting="same_kind")

    def _plan(self, start: int, stop: int) -> GradientStep:
        """Plans the gradient step of the agents [start, stop)."""
        part = slice(start, stop)
        return self._step_type(
            self._shape,
            self._config,
            self._discount,
            self._weights[part],
            self._gradient[part, 0],
            self.batch[part],
            self._scratch,
        )

    def _descend(self, start: int, stop: int) -> None:
        """Moves the weights; with a schedule each agent's rate is that of its own updates."""
        if self._config.learning_rate_end is None:
            self._adam(start, stop, self._config.learning_rate)
            return
        for agent in range(start, stop):
            rate = learning_rate_at(self._config, int(self.steps[agent]))
            self._adam(agent, agent + 1, rate)

    def _adam(self, start: int, stop: int, rate: float) -> None:
        """Adam, Kingma and Ba, ICLR 2015, with torch's defaults.

        The functional form that `torch.optim.Adam(fused=True)` ends in, without its 30 us.
        """
        self.steps[start:stop] += 1
        torch._fused_adam_(
            self._online[start:stop],
            self._gradients[start:stop],
            self._first[start:stop],
            self._second[start:stop],
            [],
            self._step_counts[start:stop],
            lr=rate,
            beta1=_BETAS[0],
            beta2=_BETAS[1],
            weight_decay=0.0,
            eps=_EPSILON,
            amsgrad=False,
            maximize=False,
        )

    def _polyak_update(self, start: int, stop: int, tau: float) -> None:
        """Soft target, Lillicrap et al., ICLR 2016; NumPy's plain steps round alike anywhere."""
        online, target = self.weights[start:stop, 0], self.weights[start:stop, 1]
        gap = online - target
        gap *= tau
        target += gap


def learning_rate_at(config: AgentConfig, updates: int) -> float:
    """Alpha after so many updates of an agent: falling linearly and then constant, or constant."""
    if config.learning_rate_end is None:
        return config.learning_rate
    share = min(updates / config.learning_rate_updates, 1.0)
    return config.learning_rate + share * (config.learning_rate_end - config.learning_rate)


def contiguous_runs(chosen: Sequence[bool], most: int) -> Iterator[tuple[int, int]]:
    """Runs [start, stop) of chosen agents that stand side by side, first to last.

    Runs of more than `most` are cut into even parts.
    """
    start = None
    for agent, flag in enumerate([*chosen, False]):
        if flag and start is None:
            start = agent
        elif not flag and start is not None:
            parts = -(-(agent - start) // most)
            cuts = [start + (agent - start) * part // parts for part in range(parts + 1)]
            yield from pairwise(cuts)
            start = None


def _rows(agents: int, parts: int, size: int) -> torch.Tensor:
    """Zeros of shape (n, parts, size) in which every row starts on a cache line."""
    every = aligned_zeros(agents * parts, size)
    stride = every.stride(0)
    return every.as_strided((agents, parts, size), (parts * stride, stride, 1))
