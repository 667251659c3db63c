"""The nearest feasible power levels, by dynamic programming: the search behind ``env.power``.

Levels and ranks are those of ``env.power``: p = P_max / 2^l, everything in rank order, strongest
channel first, powers as fractions of P_max.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from env.arrays import Bools, Floats, Ints

FIRST_EXCESS = 16
"""How far above the least distance a combination that keeps margins is sought at first."""

MAX_CELLS = 2**23
"""Most cells of a table of the search."""

NEVER = 10**6
"""A distance above any that is possible."""


def project_levels(
    picks: Ints, count: Ints, levels: int, least_gap: Floats | None = None
) -> tuple[Ints, Bools]:
    """The feasible combination nearest to the picks, by dynamic programming over levels.

    Feasible are levels that strictly fall with the rank (a weaker robot gets more power) with
    Delta_k >= rho_min, Eq. (2): p_k minus the power of all stronger ranks is at least
    ``least_gap``. Nearest is the least sum of |level - pick|, and among those the least total
    power, which is unique since powers of two are.

    Of two choices for the stronger ranks that cost the same distance, the one of less power leaves
    every later margin at least as wide, so no other needs to be kept. Without margins the nearest
    distance D of a row is quick to find, so only distances of D to D + excess are searched: an
    excess of 0 suffices without margins, and with them it widens until a combination is found, or
    shown not to exist. A search takes O(K N_P excess) steps a row.

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
    chosen, feasible = np.zeros_like(picks), np.zeros(rows, dtype=bool)
    open_rows = np.arange(rows)
    worst = ranks * (levels - 1)
    excess = 0 if least_gap is None else min(FIRST_EXCESS, worst)
    while len(open_rows):
        slacks = levels - max(int(count[open_rows].min()), 1) + 1
        for at in _chunks(open_rows, ranks * slacks * (excess + 2)):
            gap = None if least_gap is None else least_gap[at]
            chosen[at], feasible[at] = _Search(picks[at], count[at], levels).nearest(excess, gap)
        open_rows = open_rows[~feasible[open_rows]]
        if excess >= worst or least_gap is None:
            break
        if excess == FIRST_EXCESS and len(open_rows):
            bound = _excess_bound(picks[open_rows], count[open_rows], levels, least_gap[open_rows])
            open_rows = open_rows[bound >= 0]
            worst = min(worst, int(bound.max()))
        excess = min(4 * excess, worst)
    return chosen, feasible


def _excess_bound(picks: Ints, count: Ints, levels: int, least_gap: Floats) -> Ints:
    """An excess within which a combination that keeps the margins lies, (B,); -1 if none does.

    It is that of the feasible combination of least power, whatever was picked.
    """
    found, feasible = _Search(picks, count, levels, anywhere=True).nearest(0, least_gap)
    distance = np.where(found > 0, np.abs(found - picks), 0).sum(axis=-1)
    return np.where(feasible, distance - _Search(picks, count, levels).to_go[0, :, 0], -1)


def _chunks(rows: Ints, cells: int) -> list[Ints]:
    """Rows in groups whose tables, of so many cells a row, stay small."""
    size = max(MAX_CELLS // cells, 1)
    return [rows[first : first + size] for first in range(0, len(rows), size)]


class _Search:
    """The dynamic programme, over ranks from the strongest and the *slack* s of each.

    A level falls by at least one from rank to rank: with l = N_P - r - s at rank r = 0.., the slack
    s never falls and ends at most at N_P - n, where n ranks are served. Ranks that are not served
    cost nothing, take no power and keep no margin. A *gate* (r, s) stands for all choices up to
    rank r whose slack is at most s.

    Args:
        picks: levels picked, by rank, shape (B, K).
        count: served ranks, shape (B,).
        levels: N_P.
        anywhere: leave the picks out, to see whether anything is feasible.
    """

    def __init__(self, picks: Ints, count: Ints, levels: int, *, anywhere: bool = False) -> None:
        rows, ranks = picks.shape
        self.last = levels - np.maximum(count, 1)  # the widest slack of each row
        slack = np.arange(self.last.max(initial=0) + 1)
        self.served = np.arange(ranks) < count[:, None]
        self.level = levels - np.arange(ranks)[:, None] - slack  # (K, S)
        served, outside = self.served[..., None], slack > self.last[:, None]
        self.power = np.where(served, np.exp2(-self.level.astype(np.float64)), 0.0)  # (B, K, S)
        distance = np.abs(self.level - picks[..., None]) * (not anywhere)
        self.distance = np.where(served, distance, 0) + outside[:, None] * NEVER
        # The least distance of ranks r.. where their slack is at least s.
        self.to_go = np.empty((ranks + 1, rows, len(slack)), dtype=np.int64)
        self.to_go[ranks] = outside * NEVER
        for rank in reversed(range(ranks)):
            either = self.distance[:, rank] + self.to_go[rank + 1]
            self.to_go[rank] = np.minimum.accumulate(either[:, ::-1], axis=1)[:, ::-1]

    def nearest(self, excess: int, least_gap: Floats | None) -> tuple[Ints, Bools]:
        """The nearest combination of each row, if one is at most ``excess`` above the least.

        The tables hold the least total power by gate and by 1 + e, where e is by how much the
        distance so far, with the least one still to go, is above the row's least; place 0 is inf.
        """
        rows, ranks, slacks = self.distance.shape
        start = self.to_go[0] - self.to_go[0, :, :1]
        gate = np.where(np.arange(-1, excess + 1) == start[..., None], 0.0, np.inf)
        gate[..., 0] = np.inf
        taken = np.zeros((ranks, rows, slacks, excess + 2), dtype=np.int16)
        for rank in range(ranks):
            power = self.power[:, rank, :, None]
            total = _later(gate, self._detour(rank))
            if rank and least_gap is not None:
                gap = np.where(self.served[:, rank], least_gap[:, rank - 1], -np.inf)
                total = np.where(power - total >= gap[:, None, None], total, np.inf)
            gate = total + power
            self._open(gate, taken[rank], self.to_go[rank + 1])
        return self._trace(gate, taken)

    def _detour(self, rank: int) -> Ints:
        """By how much each slack at a rank is above the best one from its gate on, (B, S)."""
        return np.asarray(self.distance[:, rank] + self.to_go[rank + 1] - self.to_go[rank])

    @staticmethod
    def _open(gate: Floats, taken: NDArray[np.int16], to_go: Ints) -> None:
        """Turns a table by slack into one by gate, in place, and notes which slack is taken."""
        steps = np.diff(to_go, axis=1)
        taken[:] = np.arange(gate.shape[1])[:, None]
        for slack in range(1, gate.shape[1]):
            place = _places(gate.shape[-1], steps[:, slack - 1])
            carried = np.take_along_axis(gate[:, slack - 1], place, axis=-1)
            less = carried < gate[:, slack]
            np.copyto(gate[:, slack], carried, where=less)
            source = np.take_along_axis(taken[:, slack - 1], place, axis=-1)
            np.copyto(taken[:, slack], source, where=less)

    def _trace(self, gate: Floats, taken: NDArray[np.int16]) -> tuple[Ints, Bools]:
        """Reads the nearest combination of each row back from the tables."""
        rows, ranks = self.served.shape
        row, slack = np.arange(rows), self.last
        found = np.isfinite(gate[row, slack])
        feasible, place = found.any(axis=-1), found.argmax(axis=-1)
        chosen = np.zeros((rows, ranks), dtype=np.int64)
        for rank in reversed(range(ranks)):
            before, to_go = slack, self.to_go[rank + 1]
            slack = taken[rank, row, before, place].astype(np.int64)
            chosen[:, rank] = self.level[rank, slack]
            place = place - (to_go[row, before] - to_go[row, slack])
            place = np.maximum(place - self._detour(rank)[row, slack], 0)
        return np.where(self.served & feasible[:, None], chosen, 0), feasible


def _places(size: int, shift: Ints) -> Ints:
    """Where each entry of a table's last axis lies before a shift to the right; 0 if nowhere."""
    return np.asarray(np.maximum(np.arange(size) - shift[..., None], 0))


def _later(table: Floats, shift: Ints) -> Floats:
    """A table shifted to the right along its last axis, filled with its entry 0."""
    return np.take_along_axis(table, _places(table.shape[-1], shift), axis=-1)
