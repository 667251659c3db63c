"""Whom the server asks for weights: the best channels have the shortest uploads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from training.exchange.reception import Heard

Robots = NDArray[np.intp]


def strongest(channel_db: NDArray[np.float64], count: int | None) -> Robots:
    """The robots with the best channels.

    Args:
        channel_db: 10 lg |h|^2 of each robot, shape (K,).
        count: M, how many; None is all.

    Returns:
        Who they are, ascending, shape (M,); of equal channels the first robot's counts as better.
    """
    return np.sort(np.argsort(-channel_db, kind="stable")[:count])


def only(heard: Heard, asked: Robots) -> Heard:
    """Of the uploads that were heard those of robots that were asked."""
    ours = np.isin(heard.robots, asked)
    return heard if ours.all() else Heard(heard.robots[ours], heard.rows[ours])
