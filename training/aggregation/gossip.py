"""Averaging with nobody in the middle: each robot mixes its weights with its neighbours'.

Robot k takes sum_j W_kj x_j over itself and its neighbours, with the Metropolis weights of Boyd et
al., "Randomized gossip algorithms", 2006: W_kj = 1 / (1 + max(d_k, d_j)) along an edge between
robots with d_k and d_j neighbours, and the rest of 1 on the diagonal. W is symmetric and doubly
stochastic, so mixing keeps the mean of all robots and brings them closer to it. Between two mixings
each learns by itself, which makes it decentralised SGD (Lian et al., 2017, arXiv:1705.09056).

The sum is of float64 products in the order of the robots and is rounded to float32 once (see
``aggregator``): equal rows come back bit for bit, and on the complete graph all robots get the
bits of FedAvg.

It is computed here, where all uploads are, in place of K robots that each do their own row.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from conf import StrategyConfig
from env.seeding import Stream, stream

Weights = NDArray[np.float32]


class Gossip:
    """Mixes the robots' rows along a graph; random ones are drawn from the run's seed."""

    def __init__(self, config: StrategyConfig, seed: int) -> None:
        self._config, self._seed = config, seed

    def mix(self, window: int, uploads: Weights) -> Weights:
        """What each robot holds after a window, from 1: (K, 2, P), as checked uploads."""
        matrix = metropolis(neighbours(self._config, len(uploads), self._seed, window))
        rows = uploads.astype(np.float64)
        mixed = np.zeros_like(rows)
        for weights, row in zip(matrix.T, rows, strict=True):  # column by column: a fixed order
            mixed += weights[:, None, None] * row
        return mixed.astype(np.float32)


def neighbours(config: StrategyConfig, robots: int, seed: int, window: int) -> NDArray[np.bool_]:
    """Who hears whom in a window, symmetric and without loops, shape (K, K).

    On a random graph each robot picks ``degree`` others, and an edge stands where either picked
    the other.
    """
    edges = np.zeros((robots, robots), dtype=bool)
    everybody = np.arange(robots)
    if config.graph == "ring":
        edges[everybody, (everybody + 1) % robots] = True
    elif config.graph == "complete":
        edges[:] = True
    else:
        generator = stream(seed, Stream.GOSSIP, window)
        for robot in everybody:
            others = np.delete(everybody, robot)
            count = min(config.degree, len(others))
            edges[robot, generator.choice(others, count, replace=False)] = True
    edges |= edges.T
    np.fill_diagonal(edges, False)
    return edges


def metropolis(edges: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The doubly stochastic matrix of a graph's edges, as ``neighbours`` has them, (K, K)."""
    degree = [int(count) for count in edges.sum(axis=1)]
    matrix = np.zeros(edges.shape)
    for robot, row in enumerate(edges):
        others = np.flatnonzero(row).tolist()
        shares = [Fraction(1, 1 + max(degree[robot], degree[other])) for other in others]
        matrix[robot, others] = [float(share) for share in shares]
        matrix[robot, robot] = float(1 - sum(shares))  # of fractions: 1/K where 1/K is due
    return matrix


def mean_degree(config: StrategyConfig, robots: int) -> float:
    """The number of neighbours that a robot has, in the mean over robots and random graphs."""
    if config.graph == "ring":
        return min(2, robots - 1)
    if config.graph == "complete":
        return robots - 1
    picks = config.degree / (robots - 1)  # of one robot by another
    return (robots - 1) * (1 - (1 - picks) ** 2)
