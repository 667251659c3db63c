"""Whom the server asks for weights: the best channels have the shortest uploads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conf import Config

Robots = NDArray[np.intp]


def asked_robots(config: Config) -> int:
    """How many robots are asked for weights in a window."""
    robots, federation = config.env.robots, config.federation
    if federation.hear is not None:
        return federation.hear
    return max(1, round(federation.fraction * robots))


def strongest(channel_db: NDArray[np.float64], count: int | None) -> Robots:
    """The robots with the best channels.

    Args:
        channel_db: 10 lg |h|^2 of each robot, shape (K,).
        count: M, how many; None is all.

    Returns:
        Who they are, ascending, shape (M,); of equal channels the first robot's counts as better.
    """
    return np.sort(np.argsort(-channel_db, kind="stable")[:count])
