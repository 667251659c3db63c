"""Points of Fig. 4 and how they compare, from what each run came to or what was planned for it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.reproduce.results.output import write_table
from experiments.reproduce.results.statistics import Estimate, Floats, estimate

LEARNED = "learned"
BEST = "learned, best"
"""With ``experiment=best``."""

PLANNED = "planned"
PLANNED_AGAIN = "planned, reallocate"
"""Under OMA, with the parts of robots that have arrived dealt out again."""

AXES = {"robots": "K = {} over {}", "side": "M_R = {} over {}", "max_dbm": "{} over {} dBm"}
"""What is compared with the next smaller one, and how that is called."""


class Of(NamedTuple):
    """What an outcome is of.

    Attributes:
        robots: K.
        side: M_R.
        max_dbm: P_max in dBm.
        access: noma or oma.
        curve: learned (with the defaults or ``experiment=best``), planned, or planned with the
            other share of OMA.
    """

    robots: int
    side: int
    max_dbm: int
    access: str
    curve: str


class PointOutcome(NamedTuple):
    """What one run came to, or what was planned for its starts.

    Attributes:
        robots: with the next four as in ``Of``.
        seed: the run's.
        ee: energy efficiency in bit/s/Hz/J, the objective (5a); a robot that does not arrive counts
            with T_max.
        success: share of the robots that arrive.
        sum_rate: in bit/s/Hz.
        min_rate: the least over robots of a robot's mean rate, in bit/s/Hz.
        greedy_ee: without exploration; None where nothing was learned.
        greedy_success: likewise.
    """

    robots: int
    side: int
    max_dbm: int
    access: str
    curve: str
    seed: int
    ee: float
    success: float
    sum_rate: float
    min_rate: float
    greedy_ee: float | None = None
    greedy_success: float | None = None


class Point(NamedTuple):
    """A point of the figure.

    Attributes:
        robots: with the next four as in ``Of``.
        seeds: how many.
        ee: mean over seeds in bit/s/Hz/J, and ``low`` and ``high`` the ends of its interval.
        success: mean over seeds.
    """

    robots: int
    side: int
    max_dbm: int
    access: str
    curve: str
    seeds: int
    ee: float
    low: float
    high: float
    success: float


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


def by_setting(found: Sequence[PointOutcome]) -> dict[Of, dict[int, PointOutcome]]:
    """Outcomes by what they are of and by seed, in the order in which they come."""
    groups: dict[Of, dict[int, PointOutcome]] = {}
    for each in found:
        groups.setdefault(Of(*each[:5]), {})[each.seed] = each
    return groups


def points(found: Sequence[PointOutcome]) -> list[Point]:
    """Means and intervals over seeds, in the order of their first outcome."""
    drawn = []
    for of, those in by_setting(found).items():
        ee = estimate([each.ee for each in those.values()], mean)
        success = float(np.mean([each.success for each in those.values()]))
        drawn.append(Point(*of, ee.seeds, ee.value, ee.low, ee.high, success))
    return drawn


def mean(values: Floats) -> Floats:
    """The mean along the last axis."""
    return np.asarray(values.mean(axis=-1))


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
