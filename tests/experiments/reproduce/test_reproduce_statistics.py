"""Statistics over seeds, against values worked out by hand and by their properties."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.reproduce.results import statistics
from experiments.reproduce.results.statistics import (
    ConvergenceTimes,
    Estimate,
    converged,
    difference,
    estimate,
    iqm,
    reduction,
)

NUMBERS = st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=12)
PAIRS = st.lists(
    st.tuples(st.floats(1, 1e4), st.floats(1, 1e4), st.booleans(), st.booleans()),
    min_size=2,
    max_size=9,
)


def at(*values: float, never: tuple[int, ...] = ()) -> ConvergenceTimes:
    """Convergence times; ``never`` names the runs that had not converged when they ended."""
    return ConvergenceTimes(np.array(values, float), np.isin(np.arange(len(values)), never))


def test_the_interquartile_mean_is_that_of_the_middle_half() -> None:
    assert iqm([5, 1, 100, 2, 3]) == pytest.approx(10 / 3)  # 2, 3, 5
    assert iqm([8, 1, 2, 4]) == 3
    assert iqm([1, 2, 6]) == 3
    assert iqm([[1, 2, 6], [0, 0, 3]]).tolist() == [3, 1]


@given(NUMBERS, st.floats(-1e3, 1e3))
def test_the_interquartile_mean_lies_among_the_values_and_moves_with_them(
    values: list[float], shift: float
) -> None:
    found = float(iqm(values))
    assert min(values) - 1e-6 <= found <= max(values) + 1e-6
    assert iqm(np.array(values) + shift) == pytest.approx(found + shift, abs=1e-6)
    assert iqm(values[::-1]) == found


@given(NUMBERS)
def test_an_interval_holds_the_number_and_lies_among_the_values(values: list[float]) -> None:
    found = estimate(values)
    slack = 1e-9 * max(map(abs, values)) + 1e-9
    assert min(values) - slack <= found.low <= found.high <= max(values) + slack
    assert found.seeds == len(values)
    assert estimate(values) == found  # no global random state


def test_an_interval_is_as_wide_as_that_of_the_mean_of_many() -> None:
    values = np.random.default_rng(0).normal(size=400)
    found = estimate(values, lambda x: x.mean(axis=-1))
    assert found.value == pytest.approx(values.mean())
    assert found.high - found.low == pytest.approx(2 * 1.96 * values.std() / 20, rel=0.1)


def test_equal_values_have_an_interval_of_no_width_and_one_value_none() -> None:
    assert estimate([2.0, 2.0, 2.0]) == Estimate(2.0, 2.0, 2.0, 3)
    alone = estimate([2.0])
    assert (alone.value, alone.seeds) == (2.0, 1)
    assert np.isnan([alone.low, alone.high]).all()
    assert estimate([np.nan, 1.0, 3.0]).seeds == 2
    assert np.isnan(estimate([]).value)


def test_differences_are_of_the_same_seed() -> None:
    # Seeds differ much, the pairs by 1 alone: paired, that is certain.
    found = difference([11.0, 101.0, 1001.0], [10.0, 100.0, 1000.0])
    assert (found.value, found.low, found.high) == (1.0, 1.0, 1.0)


def test_a_band_is_the_mean_and_its_interval_point_by_point() -> None:
    mean, low, high = statistics.mean_band([[0.0, 1.0], [2.0, 1.0]])
    assert mean.tolist() == [1.0, 1.0]
    assert low.tolist() == [0.0, 1.0]
    assert high.tolist() == [2.0, 1.0]


# --- Convergence ----------------------------------------------------------------------------------


def test_a_reduction_is_the_share_that_ours_is_less() -> None:
    found = reduction(at(50, 50, 50), at(200, 200, 200))
    assert (found.value, found.low, found.high, found.bound) == (0.75, 0.75, 0.75, "")
    slower = reduction(at(90, 90), at(60, 60))
    assert slower.value == pytest.approx(-0.5)


def test_a_rival_that_never_converged_makes_the_reduction_a_lower_bound() -> None:
    found = reduction(at(50, 50, 50), at(200, 200, 200, never=(0,)))
    assert (found.value, found.bound, found.low, found.high) == (0.75, "≥", 0.75, 1.0)
    assert found.text(".0f", 100.0) == "≥75 (75 to 100)"


def test_a_run_of_ours_that_never_converged_makes_it_an_upper_bound() -> None:
    found = reduction(at(50, 50, 50, never=(1,)), at(200, 200, 200))
    assert (found.value, found.bound, found.high) == (0.75, "≤", 0.75)
    assert np.isneginf(found.low)
    assert found.text(".0f", 100.0) == "≤75 (-∞ to 75)"


def test_with_both_nothing_is_known_of_the_reduction() -> None:
    found = reduction(at(50, 50, never=(1,)), at(200, 200, never=(0,)))
    assert found.bound == "?"
    assert found.text(".2f") == "-"


def test_one_slow_run_of_five_is_outside_of_the_middle_and_no_bound() -> None:
    found = converged(at(100, 110, 120, 130, 300, never=(4,)))
    assert (found.value, found.bound) == (120.0, "")
    assert np.isposinf(found.high)  # but it may come twice in a resample
    two = converged(at(100, 110, 120, 300, 300, never=(3, 4)))
    assert (two.value, two.bound) == (pytest.approx(530 / 3), "≥")


@given(PAIRS)
def test_bounds_hold_whatever_the_runs_would_have_come_to(
    pairs: list[tuple[float, float, bool, bool]],
) -> None:
    ours, theirs, ours_never, theirs_never = map(np.array, zip(*pairs, strict=True))
    found = reduction(ConvergenceTimes(ours, ours_never), ConvergenceTimes(theirs, theirs_never))
    true = 1 - iqm(np.where(ours_never, 3 * ours, ours)) / iqm(
        np.where(theirs_never, 5 * theirs, theirs)
    )
    slack = 1e-9 * (1 + abs(true))
    if found.bound in ("", "≥"):
        assert true >= found.value - slack
    if found.bound in ("", "≤"):
        assert true <= found.value + slack
    assert found.low <= found.high


def run(converged: dict[str, float] | None, successes: list[float]) -> Any:
    """A run of 100 episodes that was evaluated after every tenth."""
    count = len(successes)
    rows = {
        "success": np.array(successes),
        "episode": 10.0 * np.arange(1, count + 1),
        "tick": 1000.0 * np.arange(1, count + 1),
        "cpu_s": np.arange(1.0, count + 1),
    }
    summary = {"converged": converged, "episodes": 100, "ticks": 10_000, "cpu_s": 12.0}
    return SimpleNamespace(summary=summary, evaluations=lambda: rows)


def test_convergence_is_read_from_runs_in_each_unit() -> None:
    there = run({"episode": 30, "tick": 3000, "cpu_s": 3.5}, [0.0, 0.5, 0.9, 0.9, 0.9])
    never = run(None, [0.0, 0.5, 0.9, 0.9, 0.8])
    for unit, expected in {
        "episode": [30, 100],
        "tick": [3000, 10_000],
        "cpu_s": [3.5, 12],
    }.items():
        found = statistics.times([there, never], unit)
        assert found.values.tolist() == expected
        assert found.censored.tolist() == [False, True]
        assert found.latest.tolist() == [expected[0], np.inf]


def test_a_run_that_ends_in_good_evaluations_may_have_converged_with_the_first_of_them() -> None:
    found = statistics.times([run(None, [0.0, 0.5, 0.95, 0.9])], "episode")
    assert found.values.tolist() == [30]
    assert found.censored.tolist() == [True]
    assert statistics.times([run(None, [])], "episode").values.tolist() == [100]
