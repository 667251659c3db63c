"""Tables of Fig. 4: the points by power budget, and how much larger one is than its neighbour."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.reproduce.results.output import write_table
from experiments.reproduce.results.points import (
    BEST,
    LEARNED,
    PLANNED,
    PLANNED_AGAIN,
    Of,
    Point,
    PointOutcome,
    by_setting,
    mean,
)
from experiments.reproduce.results.statistics import Estimate, estimate

AXES = {"robots": "K = {} over {}", "side": "M_R = {} over {}", "max_dbm": "{} over {} dBm"}


class Neighbour(NamedTuple):
    """By how much EE is larger than that of a neighbour, all else being equal.

    Attributes:
        what: what is compared, such as NOMA over OMA.
        robots: with the next four as in ``Of``, of the one that is larger, or smaller.
        seeds: how many pairs.
        percent: the mean over seeds of the relative difference, each of the same starts; ``low``
            and ``high`` are the ends of its interval.
        least_success: the smaller one of both mean successes.
    """

    what: str
    robots: int
    side: int
    max_dbm: int
    access: str
    curve: str
    seeds: int
    percent: float
    low: float
    high: float
    least_success: float


def write_points(file: Path, drawn: Sequence[Point], note: str) -> Path:
    """Writes the points as a table, a column for each power budget."""
    powers_dbm = sorted({point.max_dbm for point in drawn})
    rows: dict[tuple[int, str, str, int], dict[int, str]] = {}
    for point in drawn:
        of = point.robots, point.access.upper(), point.curve, point.side
        there = Estimate(point.ee, point.low, point.high, point.seeds)
        rows.setdefault(of, {})[point.max_dbm] = there.text(".4f")
    header = ["K", "access", "", "M_R", *(f"{power} dBm" for power in powers_dbm)]
    cells = [(*of, *(rows[of].get(power, "") for power in powers_dbm)) for of in sorted(rows)]
    return write_table(file, header, cells, f"EE in bit/s/Hz/J. {note}")


def neighbours(found: Sequence[PointOutcome]) -> list[Neighbour]:
    """NOMA over OMA, and each K, M_R and P_max over the next smaller one."""
    groups = by_setting(found)
    return [
        _compared(what, ours, groups[ours], groups[theirs])
        for ours in groups
        for what, theirs in _neighbours(ours, list(groups))
        if theirs in groups
    ]


def _neighbours(ours: Of, there: Sequence[Of]) -> Iterator[tuple[str, Of]]:
    """What a group is compared with: what it is called, and which group that is."""
    if ours.access == "noma":
        yield "NOMA over OMA", ours._replace(access="oma")
        if ours.curve == PLANNED:
            yield "NOMA over OMA, reallocated", ours._replace(access="oma", curve=PLANNED_AGAIN)
    if ours.curve == BEST:
        yield "best over the defaults", ours._replace(curve=LEARNED)
    for axis, text in AXES.items():
        here = getattr(ours, axis)
        below = [getattr(of, axis) for of in there if getattr(of, axis) < here]
        if below:
            yield text.format(here, max(below)), ours._replace(**{axis: max(below)})


def _compared(
    what: str, of: Of, ours: dict[int, PointOutcome], theirs: dict[int, PointOutcome]
) -> Neighbour:
    pairs = [(ours[seed], theirs[seed]) for seed in ours if seed in theirs]
    found = estimate([100.0 * (one.ee / other.ee - 1.0) for one, other in pairs], mean)
    success = min(np.mean([each.success for each in side]) for side in zip(*pairs, strict=True))
    return Neighbour(what, *of, found.seeds, found.value, found.low, found.high, float(success))
