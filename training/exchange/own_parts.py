"""What stays each robot's own of its network, and what is shared.

Layers: the output layer (FedPer, Arivazhagan et al., 2019, arXiv:1912.00818), all layers but it
(LG-FedAvg, Liang et al., 2020, arXiv:2001.01523), or the first one.

Normalisation (after FedBN, Li et al., 2021, arXiv:2102.07623): each robot has the mean and the
deviation of what it has observed, and networks are averaged as they are on normalised observations.
Nothing normalises while acting or learning: with z = (x - mean) / deviation, a first layer
W, b on x is exactly one on z, A = deviation W and c = b + mean W, so A and c are averaged and each
robot gets them back as W and b of its own. The server simulates what robots observe, so it keeps
the statistics; real robots would convert their own layers, and send A and c.

Own layers cross to the server and back unchanged, since evaluation plays each robot's network; real
robots would keep them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent import NetworkShape
from conf import Config, robot_network
from env.local_env import LocalEnv
from env.scenario import Scenario
from lockstep import Flag

DRIVING = np.uint16(Flag.DRIVING)
Weights = NDArray[np.float32]
State = Mapping[str, NDArray[Any]]


class OwnParts(ABC):
    """Splits networks into what is shared and what is a robot's own; keeps nothing by default."""

    @abstractmethod
    def shared(self, rows: Weights, robots: NDArray[np.intp]) -> Weights:
        """What is combined of robots' networks.

        Args:
            rows: shape (n, 2, P).
            robots: whose they are, shape (n,).

        Returns:
            Shape (n, 2, P') with P' at most P.
        """

    @abstractmethod
    def merged(self, rows: Weights, combined: Weights) -> Weights:
        """All robots' networks with what was combined in them, shape (K, 2, P).

        Args:
            rows: what they had, shape (K, 2, P).
            combined: shape (2, P').
        """

    def observed(self, updates: np.ndarray) -> None:  # noqa: B027 - most look at weights alone
        """Takes notice of the records of a step, shape (K E,)."""

    def state(self) -> dict[str, NDArray[Any]]:
        """What it keeps between windows."""
        return {}

    def restore(self, state: State) -> None:  # noqa: B027 - as above
        """Takes back what ``state`` gave."""


class OwnLayers(OwnParts):
    """Layers that are not combined: ``heads``, ``trunk`` or ``input``."""

    def __init__(self, shape: NetworkShape, own: str) -> None:
        self._shared = shared_numbers(shape, own)

    def shared(self, rows: Weights, robots: NDArray[np.intp]) -> Weights:
        """See ``OwnParts.shared``."""
        return rows[..., self._shared]

    def merged(self, rows: Weights, combined: Weights) -> Weights:
        """See ``OwnParts.merged``."""
        found = rows.copy()
        found[..., self._shared] = combined
        return found


class OwnNormalisation(OwnParts):
    """First layers that are combined as they are on each robot's normalised observations.

    Statistics begin as those of one observation of mean 0 and variance 1.
    """

    def __init__(self, config: Config) -> None:
        robots, self._network = config.env.robots, robot_network(config)
        scenario = Scenario.drawn(config.env, config.seed)
        self._local = LocalEnv(scenario, config.train.worlds)
        self._robot = np.repeat(np.arange(robots), config.train.worlds)
        self._seen = ("cell", "channel_db", "broadcast")[: 3 if self._local.broadcast_size else 2]
        self._count = np.ones(robots)
        self._total = np.zeros((robots, self._network.inputs))
        self._squares = np.ones_like(self._total)

    def observed(self, updates: np.ndarray) -> None:
        """See ``OwnParts.observed``: counts what driving robots observe."""
        seen = self._local.observe(*(updates[part] for part in self._seen)).astype(np.float64)
        drives = np.flatnonzero(updates["flags"] & DRIVING)
        robot, seen = self._robot[drives], seen[drives]
        np.add.at(self._count, robot, 1)
        np.add.at(self._total, robot, seen)
        np.add.at(self._squares, robot, seen**2)

    def moments(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and deviation of what each robot has observed, both of shape (K, inputs)."""
        mean = self._total / self._count[:, None]
        variance = self._squares / self._count[:, None] - mean**2
        return mean, np.sqrt(np.maximum(variance, 1e-6))

    def shared(self, rows: Weights, robots: NDArray[np.intp]) -> Weights:
        """See ``OwnParts.shared``."""
        found, weight, bias = self._opened(rows)
        mean, deviation = (moment[robots] for moment in self.moments())
        bias += np.einsum("ni,nrio->nro", mean, weight)
        weight *= deviation[:, None, :, None]
        return found.astype(np.float32)

    def merged(self, rows: Weights, combined: Weights) -> Weights:
        """See ``OwnParts.merged``."""
        found, weight, bias = self._opened(np.broadcast_to(combined, rows.shape))
        mean, deviation = self.moments()
        weight /= deviation[:, None, :, None]
        bias -= np.einsum("ni,nrio->nro", mean, weight)
        return found.astype(np.float32)

    def _opened(
        self, rows: Weights
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """A copy of networks in float64, and views of their first layers' weights and biases."""
        found = np.array(rows, np.float64)
        first = self._network.matrices(found)[0]  # type: ignore[type-var]
        return found, first[..., :-1, :], first[..., -1, :]

    def state(self) -> dict[str, NDArray[Any]]:
        """See ``OwnParts.state``."""
        kept = {"count": self._count, "total": self._total, "squares": self._squares}
        return {name: array.copy() for name, array in kept.items()}  # it counts on in place

    def restore(self, state: State) -> None:
        """See ``OwnParts.restore``."""
        self._count, self._total, self._squares = (
            np.array(state[name]) for name in ("count", "total", "squares")
        )


def shared_numbers(shape: NetworkShape, own: str) -> NDArray[np.bool_]:
    """Which of a network's numbers are combined with this ``federation.own``, shape (P,)."""
    sizes = [(inputs + 1) * outputs for inputs, outputs in shape.layers]
    layer, last = np.repeat(np.arange(len(sizes)), sizes), len(sizes) - 1
    is_shared: dict[str, NDArray[np.bool_]] = {
        "heads": layer != last,
        "trunk": layer == last,
        "input": layer != 0,
    }
    return is_shared.get(own, layer >= 0)  # without own layers all are


def own_parts(config: Config) -> OwnParts | None:
    """What stays each robot's own in a run; None where nothing does."""
    own = config.federation.own
    if own == "none":
        return None
    if own == "normalisation":
        return OwnNormalisation(config)
    return OwnLayers(robot_network(config), own)
