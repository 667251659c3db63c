"""A robot's action as one integer: four directions times N_P power levels, Eq. (10)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from env.floor import DIRECTIONS


def count(levels: int) -> int:
    """Number of actions, 4 N_P."""
    return len(DIRECTIONS) * levels


def joint_count(phases: int, robots: int, levels: int) -> int:
    """Number of joint actions of an access point with so many phase settings and K robots."""
    return int(phases * count(levels) ** robots)


def joint_decode(
    joint: NDArray[np.int64], robots: int, levels: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The phase action, same shape (...), and the robots' actions, shape (..., K), of a joint one.

    A joint action is phase (4 N_P)^K + a_0 (4 N_P)^(K-1) + ... + a_{K-1}.
    """
    single = count(levels)
    places = single ** np.arange(robots - 1, -1, -1)
    rest = joint % single**robots
    return joint // single**robots, np.asarray(rest[..., None] // places % single)


def encode(
    direction: NDArray[np.int64], level: NDArray[np.int64], levels: int
) -> NDArray[np.int64]:
    """Action of a direction index and a power level 1..N_P, any shape."""
    return np.asarray(direction * levels + level - 1)


def decode(action: NDArray[np.int64], levels: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Direction index and power level 1..N_P of an action, same shape; -1 decodes as 0."""
    direction, level = np.divmod(np.maximum(action, 0), levels)
    return direction, level + 1
