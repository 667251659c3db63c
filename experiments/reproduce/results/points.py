"""From what each run of Fig. 4 came to, to the points that are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from experiments.reproduce.results.statistics import Floats, estimate

LEARNED = "learned"
BEST = "learned, best"
"""With ``experiment=best``."""

PLANNED = "planned"
PLANNED_AGAIN = "planned, reallocate"
"""Under OMA, with the parts of robots that have arrived dealt out again."""


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
