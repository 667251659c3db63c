"""Resolving the robots' independent power picks into what the AP transmits.

Levels are l = 1..N_P with p = P_max / 2^l, so a *lower* level is *more* power. As in
``env.access``, everything is in rank order, strongest channel first; rank r of a row is served if
r < count. Powers here are fractions of P_max: their sums are exact in floating point.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MAX_TABLE = 50_000
"""Most picks for which the projection without margins is remembered."""


def fractions(levels: NDArray[np.int64]) -> NDArray[np.float64]:
    """P / P_max = 2^-l of levels l >= 1, and 0 for level 0 (not served); same shape."""
    return np.asarray(np.where(levels > 0, np.exp2(-levels.astype(np.float64)), 0.0))


def scaled_to_budget(fraction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Powers scaled down where their sum is over the budget, sum p_k <= P_max.

    Args:
        fraction: p_k / P_max, shape (..., K).

    Returns:
        The same, times 1 / sum where the sum is above 1.
    """
    return np.asarray(fraction / np.maximum(fraction.sum(axis=-1, keepdims=True), 1.0))


def project_levels(
    picks: NDArray[np.int64],
    count: NDArray[np.int64],
    levels: int,
    least_gap: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The feasible combination nearest to the picks, by dynamic programming over levels.

    Feasible are levels that strictly fall with the rank (a weaker robot gets more power) with
    Delta_k >= rho_min, Eq. (2): p_k minus the power of all stronger ranks is at least
    ``least_gap``. Nearest is the least sum of |level - pick|, and among those the least total
    power, which is unique since powers of two are.

    The table ``least[l, c]`` holds, over the ranks so far with the last one at level l and a
    distance of c, the least total power. Of two such prefixes the one of less power leaves every
    later margin at least as wide, so no other needs to be kept: the search is exact in
    O(K N_P^2 K) steps, where there are C(N_P, K) combinations.

    Args:
        picks: levels picked, by rank, shape (B, K).
        count: served ranks of each row, shape (B,), 0 to min(K, N_P).
        levels: N_P.
        least_gap: rho_min / |h_{k-1}|^2 / P_max at ranks 2..K, shape (B, K-1); None: no margin.

    Returns:
        The levels, shape (B, K), 0 at ranks not served; and whether a feasible combination
        exists, shape (B,) (rows without one hold zeros).
    """
    rows, ranks = picks.shape
    worst = ranks * (levels - 1) + 1
    power = np.exp2(-np.arange(1, levels + 1, dtype=np.float64))
    least = np.full((ranks, rows, levels, worst), np.inf)
    came_from = np.zeros((ranks, rows, levels, worst), dtype=np.int64)
    distance = np.abs(np.arange(1, levels + 1) - picks[..., None])  # (B, K, N_P)
    row = np.arange(rows)
    for rank in range(ranks):
        for level in range(levels):
            step = distance[:, rank, level]
            if rank == 0:
                least[0, row, level, step] = power[level]
                continue
            if level + 1 >= levels:  # no weaker power is left for the stronger ranks
                continue
            before = least[rank - 1, :, level + 1 :, :]
            best = before.argmin(axis=1)
            total = np.take_along_axis(before, best[:, None], axis=1)[:, 0]
            if least_gap is not None:
                total = np.where(
                    power[level] - total >= least_gap[:, rank - 1, None], total, np.inf
                )
            for shift in np.unique(step):
                at = np.flatnonzero(step == shift)
                least[rank, at, level, shift:] = total[at, : worst - shift] + power[level]
                came_from[rank, at, level, shift:] = best[at, : worst - shift] + level + 1
    return _trace(least, came_from, distance, count)


def _trace(
    least: NDArray[np.float64],
    came_from: NDArray[np.int64],
    distance: NDArray[np.int64],
    count: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Reads the nearest combination of each row back from the tables."""
    ranks, rows, _, _ = least.shape
    row = np.arange(rows)
    last = least[np.maximum(count - 1, 0), row]  # (B, N_P, C)
    by_distance = last.min(axis=1)
    feasible = np.isfinite(by_distance).any(axis=-1) | (count == 0)
    cost = np.isfinite(by_distance).argmax(axis=-1)
    level = last[row, :, cost].argmin(axis=-1)
    chosen = np.zeros((rows, ranks), dtype=np.int64)
    for rank in reversed(range(ranks)):
        at = feasible & (rank < count)
        chosen[:, rank] = np.where(at, level + 1, 0)
        before = came_from[rank, row, level, cost]
        cost = np.where(at, cost - distance[row, rank, level], cost)
        level = np.where(at, before, level)
    return chosen, feasible


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
            self._gaps = np.zeros((size, robots - 1))

    def __call__(
        self, picks: NDArray[np.int64], count: NDArray[np.int64], least_gap: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Projects picks in rank order.

        Args:
            picks: levels by rank, shape (B, K), 0 at ranks not served.
            count: served ranks, shape (B,).
            least_gap: rho_min / |h_{k-1}|^2 / P_max at ranks 2..K, shape (B, K-1).

        Returns:
            Levels, shape (B, K), and where the margin had to be dropped since no combination
            keeps it, shape (B,).
        """
        levels, gaps = self._without_margin(picks, count)
        dropped = np.zeros(len(picks), dtype=bool)
        short = (gaps < least_gap).any(axis=-1)
        if short.any():
            kept, feasible = project_levels(
                np.maximum(picks[short], 1), count[short], self._levels, least_gap[short]
            )
            levels[short] = np.where(feasible[:, None], kept, levels[short])
            dropped[short] = ~feasible
        return levels, dropped

    def _without_margin(
        self, picks: NDArray[np.int64], count: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """The nearest levels with no margin to keep, and their gaps; remembered where few."""
        if not self._remembers:
            levels, _ = project_levels(np.maximum(picks, 1), count, self._levels)
            return levels, _gaps(levels)
        index = picks @ self._place
        new = ~self._known.take(index)
        if new.any():
            at = index[new]
            levels, _ = project_levels(np.maximum(picks[new], 1), count[new], self._levels)
            self._table[at], self._gaps[at], self._known[at] = levels, _gaps(levels), True
        return self._table.take(index, axis=0), self._gaps.take(index, axis=0)


def _gaps(levels: NDArray[np.int64]) -> NDArray[np.float64]:
    """p_k less the power of all stronger ranks, over P_max, ranks 2..K; inf where not served."""
    fraction = fractions(levels)
    gap = fraction[:, 1:] - np.cumsum(fraction, axis=-1)[:, :-1]
    return np.where(levels[:, 1:] > 0, gap, np.inf)
