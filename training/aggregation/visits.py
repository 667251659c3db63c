"""A mean in which robots count by what they have visited.

FedAvg weighs clients by their numbers of samples, n_k / n (McMahan et al., 2017, Algorithm 1): here
the transitions that robot k has made in the window. Woo, Joshi and Chi, "The blessing of
heterogeneity in federated Q-learning", 2023, arXiv:2305.10697, average tables of action values with
a weight of its own for each state and action, the larger the more often the client has visited it.
A network has no row for a state, but it has one output for each action. So this is an adaptation:
the output layer's numbers of an action are averaged by how often each robot took that action, all
others by n_k, and weights are proportional to counts where the table's grow exponentially.

Where nobody has visited anything, all count alike.

No strategy of Flower's weighs one network number by number, so the sum is made here: of float64
products, in the order of the robots, rounded to float32 once (see ``aggregator``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent import NetworkShape

Weights = NDArray[np.float32]


class VisitMean:
    """Averages networks by visits."""

    def __init__(self, shape: NetworkShape) -> None:
        counted = np.zeros(shape.parameters, np.float32)
        shape.matrices(counted)[-1][:] = 1 + np.arange(shape.actions)
        self._counted = counted.astype(np.intp)
        """What a number counts by: 0 is all transitions, 1 + a is action a."""

    def mean(self, uploads: Weights, actions: NDArray[np.int64]) -> Weights:
        """The network that all robots take, shape (2, P), from uploads of shape (H, 2, P).

        ``actions`` is how often each of these robots took each action, shape (H, actions).
        """
        counts = np.column_stack([actions.sum(axis=1), actions]).astype(np.float64)
        counts[:, counts.sum(axis=0) == 0] = 1.0
        shares = counts / counts.sum(axis=0)
        mean = np.zeros(uploads.shape[1:])
        for share, row in zip(shares, uploads, strict=True):
            mean += share[self._counted] * row.astype(np.float64)
        return mean.astype(np.float32)
