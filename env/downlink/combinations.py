"""The combinations of power levels that an access point can choose among, by rank.

Levels and ranks are those of ``env.power``: p = P_max / 2^l, strongest channel first. Where the
downlink projects picks (``power.resolve=project``), a combination is of levels that strictly fall
with the rank; otherwise picks stand as they are, and any levels make one. Under OMA levels have no
effect: there is one combination.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations, product
from math import comb

import numpy as np

from env.arrays import Bools, Floats, Ints
from env.config import EnvConfig
from env.downlink import access


def count_combinations(config: EnvConfig, served: int) -> int:
    """How many combinations there are for so many robots that are served."""
    levels = config.power.levels
    if config.access == "oma":
        return 1
    return comb(levels, served) if config.power.resolve == "project" else int(levels**served)


def levels_by_rank(config: EnvConfig, robots: int, served: int) -> Ints:
    """All combinations of n = ``served`` of K = ``robots`` robots, those of least power first.

    Returns:
        Levels at each rank, shape (C, K), not to be written to; 1 at ranks past the n-th.
    """
    if config.access == "oma":
        served = 0
    return _levels_by_rank(config.power.levels, robots, served, config.power.resolve == "project")


@lru_cache(maxsize=16)
def _levels_by_rank(levels: int, robots: int, served: int, falls: bool) -> Ints:
    falling = range(levels, 0, -1)
    chosen = list(combinations(falling, served) if falls else product(falling, repeat=served))
    ranked = np.ones((len(chosen), robots), dtype=np.int64)
    ranked[:, :served] = chosen
    ranked.setflags(write=False)
    return ranked


def deal(levels: Ints, gain: Floats, served: Bools) -> Ints:
    """Deals levels by rank of |h_k|; n < K robots that are served take the last n of them.

    Args:
        levels: a combination for all K robots, strongest rank first, shape (B, K).
        gain: |h_k|^2, shape (B, K).
        served: which robots are served, shape (B, K).

    Returns:
        Each robot's level, shape (B, K); 1 for a robot that is not served.
    """
    first = levels.shape[-1] - served.sum(axis=-1, keepdims=True)
    place = np.where(served, first + access.ranks(gain, served), 0)
    return np.where(served, np.take_along_axis(levels, place, axis=-1), 1)
