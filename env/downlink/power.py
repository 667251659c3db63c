"""Resolving the robots' independent power picks into what the AP transmits.

Levels are l = 1..N_P with p = P_max / 2^l, so a *lower* level is *more* power. As in
``env.access``, everything is in rank order, strongest channel first; rank r of a row is served if
r < count. Powers here are fractions of P_max: their sums are exact in floating point.
"""

from __future__ import annotations

import numpy as np

from env.arrays import Bools, Floats, Ints
from env.downlink.power_search import project_levels

MAX_TABLE = 50_000
"""Most picks for which the projection without margins is remembered."""


def fractions(levels: Ints) -> Floats:
    """P / P_max = 2^-l of levels l >= 1, and 0 for level 0 (not served); same shape."""
    return np.asarray(np.where(levels > 0, np.exp2(-levels.astype(np.float64)), 0.0))


def scaled_to_budget(fraction: Floats) -> Floats:
    """Powers p_k / P_max, shape (..., K), over their sum where it is above 1: sum p_k <= P_max."""
    return np.asarray(fraction / np.maximum(fraction.sum(axis=-1, keepdims=True), 1.0))


class Projection:
    """The nearest feasible powers, with the common case remembered.

    A combination without margins that happens to keep them is also the nearest one with them, and
    it depends on the picks alone: so it is kept in a table, and the dynamic programme runs again
    only where a margin fails.

    Args:
        robots: K.
        levels: N_P, at least K.
    """

    def __init__(self, robots: int, levels: int) -> None:
        self._levels = levels
        size = (levels + 1) ** robots
        self._remembers = size <= MAX_TABLE
        if self._remembers:
            self._place = np.asarray((levels + 1) ** np.arange(robots))
            self._known = np.zeros(size, dtype=bool)
            self._table = np.zeros((size, robots), dtype=np.int64)
            self._changes = np.zeros(size, dtype=bool)
            self._gaps = np.zeros((size, robots - 1))

    def __call__(self, picks: Ints, least_gap: Floats) -> tuple[Ints, Bools, Bools]:
        """Projects picks in rank order.

        Args:
            picks: levels by rank, shape (B, K), 0 at ranks not served.
            least_gap: rho_min / |h_{k-1}|^2 / P_max at ranks 2..K, shape (B, K-1).

        Returns:
            Levels, shape (B, K), whether they are others than the picks, shape (B,), and where
            the margin had to be dropped since no combination keeps it, shape (B,).
        """
        if self._remembers:
            index = picks @ self._place
            short = np.count_nonzero(self._gaps.take(index, axis=0) < least_gap)
            if not short and np.count_nonzero(self._known.take(index)) == len(index):
                levels = self._table.take(index, axis=0)
                return levels, self._changes.take(index), np.zeros(len(picks), dtype=bool)
        return self._search(picks, least_gap)

    def _search(self, picks: Ints, least_gap: Floats) -> tuple[Ints, Bools, Bools]:
        """As the call, where some picks are new, or a margin fails without being asked for."""
        levels, gaps = self._without_margin(picks)
        dropped = np.zeros(len(picks), dtype=bool)
        short = (gaps < least_gap).any(axis=-1)
        if short.any():
            asked = picks[short]
            kept, feasible = project_levels(
                np.maximum(asked, 1), _served(asked), self._levels, least_gap[short]
            )
            levels[short] = np.where(feasible[:, None], kept, levels[short])
            dropped[short] = ~feasible
        return levels, (levels != picks).any(axis=-1), dropped

    def _without_margin(self, picks: Ints) -> tuple[Ints, Floats]:
        """The nearest levels with no margin to keep, and their gaps; remembered where few."""
        if not self._remembers:
            levels, broken = picks.copy(), ~_fall(picks)
            if broken.any():
                tried = np.maximum(picks[broken], 1)
                levels[broken], _ = project_levels(tried, _served(picks[broken]), self._levels)
            return levels, _gaps(levels)
        index = picks @ self._place
        new = ~self._known.take(index)
        if new.any():
            at, asked = index[new], picks[new]
            levels, _ = project_levels(np.maximum(asked, 1), _served(asked), self._levels)
            self._table[at], self._gaps[at], self._known[at] = levels, _gaps(levels), True
            self._changes[at] = (levels != asked).any(axis=-1)
        return self._table.take(index, axis=0), self._gaps.take(index, axis=0)


def _served(picks: Ints) -> Ints:
    """How many ranks of each row are served, shape (B,)."""
    return np.asarray(np.count_nonzero(picks, axis=-1))


def _fall(picks: Ints) -> Bools:
    """Rows that are feasible as they are, without margins: levels fall with the rank, (B,)."""
    return np.asarray(((picks[:, 1:] < picks[:, :-1]) | (picks[:, 1:] == 0)).all(axis=-1))


def _gaps(levels: Ints) -> Floats:
    """p_k less the power of all stronger ranks, over P_max, ranks 2..K; inf where not served."""
    fraction = fractions(levels)
    gap = fraction[:, 1:] - np.cumsum(fraction, axis=-1)[:, :-1]
    return np.where(levels[:, 1:] > 0, gap, np.inf)
