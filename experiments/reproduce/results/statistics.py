"""Statistics over seeds: interquartile means, bootstrap intervals, and runs that never got there.

Intervals are percentiles of a bootstrap over seeds, 95 %. Runs of one seed in two cells have the
same destinations and starts, so comparisons are paired: a resample takes both runs of a seed.
The interquartile mean and its merits over few seeds: Agarwal et al., 2021, arXiv:2108.13264.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from experiments.reproduce.results.runs import Run
from training.recording.history import CONVERGED

RESAMPLES = 4000
LEVEL = 0.95
ENDS = ((1 - LEVEL) / 2, 1 - (1 - LEVEL) / 2)

BOOTSTRAP_SEED = 2026
IN_A_ROW = 3
"""Evaluations with enough success that make a run converged, see ``History.converged``."""

UNITS = {"episode": "episodes", "tick": "ticks", "cpu_s": "CPU s"}
"""What convergence is counted in, and how it is called."""

LENGTHS = {"episode": "episodes", "tick": "ticks", "cpu_s": "cpu_s"}
"""Where a summary has a run's whole length, in each unit."""

Floats = NDArray[np.float64]


class Estimate(NamedTuple):
    """A number over seeds, with its interval.

    Attributes:
        value: the number, or its bound.
        low: lower end of the 95 % interval; nan with one seed, minus infinity where it is open.
        high: upper end.
        seeds: how many.
        bound: "≥" or "≤" where ``value`` is but a bound, "?" where not even that.
    """

    value: float
    low: float
    high: float
    seeds: int
    bound: str = ""

    def text(self, form: str, scale: float = 1.0) -> str:
        """Times ``scale`` in a format such as ".2f": ``≥0.59 (0.40 to 0.71)``."""
        if np.isnan(self.value) or self.bound == "?":
            return "-"
        value, low, high = (format(scale * x, form) for x in (self.value, self.low, self.high))
        if np.isnan(self.low):
            return f"{self.bound}{value}"
        low = "-∞" if np.isneginf(self.low) else low
        return f"{self.bound}{value} ({low} to {'∞' if np.isposinf(self.high) else high})"


@dataclass(frozen=True)
class ConvergenceTimes:
    """When runs of several seeds converged.

    Attributes:
        values: shape (seeds,); a run that had not converged when it ended has what is certain.
        censored: those runs, shape (seeds,).
    """

    values: Floats
    censored: NDArray[np.bool_]

    @property
    def latest(self) -> Floats:
        """The latest that is possible: infinity for a run that had not converged."""
        return np.where(self.censored, np.inf, self.values)


def iqm(values: ArrayLike) -> Floats:
    """Interquartile mean along the last axis: a quarter of the values is left out at each end.

    Whole values alone are left out: of five, the middle three count; of three, all.
    """
    ordered = np.sort(np.asarray(values, float), axis=-1)
    cut = ordered.shape[-1] // 4
    return np.asarray(ordered[..., cut : ordered.shape[-1] - cut].mean(axis=-1))


def estimate(values: ArrayLike, statistic: Callable[[Floats], Floats] = iqm) -> Estimate:
    """A statistic over seeds.

    Args:
        values: shape (seeds,); those that are not finite are left out.
        statistic: along the last axis.
    """
    found = np.asarray(values, float)
    found = found[np.isfinite(found)]
    if not len(found):
        return Estimate(np.nan, np.nan, np.nan, 0)
    low, high = _interval(statistic(_resampled(found)), len(found))
    return Estimate(float(statistic(found)), low, high, len(found))


def difference(ours: ArrayLike, theirs: ArrayLike) -> Estimate:
    """The interquartile mean of ours - theirs, both of the same seeds in the same order."""
    return estimate(np.asarray(ours, float) - np.asarray(theirs, float))


def converged(times: ConvergenceTimes) -> Estimate:
    """The interquartile mean of convergence times.

    With runs that never converged it is a lower bound, unless they are the quarter that is left
    out; so is the lower end of its interval, and the upper one may be open.
    """
    value, seeds = float(iqm(times.values)), len(times.values)
    bound = "" if iqm(times.latest) == value else "≥"
    low, _ = _interval(iqm(_resampled(times.values)), seeds)
    _, high = _interval(iqm(_resampled(times.latest)), seeds)
    return Estimate(value, low, high, seeds, bound)


def reduction(ours: ConvergenceTimes, theirs: ConvergenceTimes) -> Estimate:
    """The share of their time that ours is less, 1 - iqm(ours) / iqm(theirs), seeds paired.

    With rivals that never converged it is at least that, with runs of ours at most, with both
    unknown.
    """
    value, seeds = 1 - float(iqm(ours.values) / iqm(theirs.values)), len(ours.values)
    ours_known, theirs_known = (iqm(each.latest) == iqm(each.values) for each in (ours, theirs))
    bound = {(True, True): "", (True, False): "≥", (False, True): "≤", (False, False): "?"}
    drawn = _draws(seeds)
    low, _ = _interval(1 - iqm(ours.latest[drawn]) / iqm(theirs.values[drawn]), seeds)
    _, high = _interval(1 - iqm(ours.values[drawn]) / iqm(theirs.latest[drawn]), seeds)
    return Estimate(value, low, high, seeds, bound[bool(ours_known), bool(theirs_known)])


def mean_band(curves: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """The mean over seeds of curves, shape (seeds, points), and both ends of its interval."""
    found = np.asarray(curves, float)
    means = found[_draws(len(found))].mean(axis=1)
    low, high = np.quantile(means, ENDS, axis=0)
    return found.mean(axis=0), low, high


def times(runs: Sequence[Run], unit: str) -> ConvergenceTimes:
    """When runs converged.

    Args:
        runs: one a seed.
        unit: a key of ``UNITS``. Processor seconds are those of the run's process up to that
            evaluation, the evaluations included.
    """
    found = [run.summary["converged"] for run in runs]
    values = [
        float(when[unit]) if when else _not_before(run, unit)
        for run, when in zip(runs, found, strict=True)
    ]
    return ConvergenceTimes(np.array(values), np.array([when is None for when in found]))


def _not_before(run: Run, unit: str) -> float:
    """From when on a run may have converged that had not when it ended."""
    rows = run.evaluations()
    last = rows["success"][:-IN_A_ROW:-1]
    streak = len(list(takewhile(lambda success: success >= CONVERGED, last)))
    return float(rows[unit][-streak] if streak else run.summary[LENGTHS[unit]])


def _draws(count: int) -> NDArray[np.int64]:
    """Seeds drawn with replacement, shape (RESAMPLES, count), the same in every call."""
    return np.random.default_rng(BOOTSTRAP_SEED).integers(count, size=(RESAMPLES, count))


def _resampled(values: Floats) -> Floats:
    return values[_draws(len(values))]


def _interval(resampled: Floats, seeds: int) -> tuple[float, float]:
    """Both ends of the interval; nothing is interpolated, since an end may be infinite."""
    if seeds < 2:
        return np.nan, np.nan
    low, high = np.quantile(resampled, ENDS, method="inverted_cdf")
    return float(low), float(high)
