"""The projection of picks onto feasible powers, against a search of all combinations."""

import functools
from itertools import combinations
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env.config import EnvConfig, PowerConfig
from env.downlink.allocation import Downlink
from env.downlink.power import MAX_TABLE, fractions, scaled_to_budget
from env.downlink.power_search import project_levels

NEVER = 2.0


@st.composite
def problems(draw, most=6):
    """One row: picks by rank, N_P, and the least gap at each rank past the first."""
    ranks, count = draw(st.integers(1, most)), draw(st.integers(6, 12))
    picks = draw(st.lists(st.integers(1, count), min_size=ranks, max_size=ranks))
    # Gaps that powers of two reach exactly, and others between and beyond them.
    exact = st.integers(1, count).map(lambda level: 2.0**-level)
    gap = st.one_of(st.just(0.0), exact, st.floats(0.0, 0.2), st.just(NEVER))
    gaps = draw(st.lists(gap, min_size=ranks - 1, max_size=ranks - 1))
    return picks, count, gaps


def nearest(picks, levels, gaps=None):
    """The nearest feasible levels by rank, or None, from a search of all C(N_P, K)."""
    found = None
    for falling in combinations(range(levels, 0, -1), len(picks)):
        power = [2.0**-level for level in falling]
        margins = [power[r] - sum(power[:r]) for r in range(1, len(power))]
        if gaps is not None and any(m < g for m, g in zip(margins, gaps, strict=True)):
            continue
        score = (sum(abs(x - y) for x, y in zip(falling, picks, strict=True)), sum(power))
        if found is None or score < found[0]:
            found = (score, list(falling))
    return found and found[1]


def project(picks, levels, gaps=None):
    least_gap = None if gaps is None else np.array([gaps]).reshape(1, len(picks) - 1)
    found, feasible = project_levels(np.array([picks]), np.array([len(picks)]), levels, least_gap)
    return found[0].tolist() if feasible[0] else None


@functools.cache
def downlink(robots, levels, tabled=True):
    """The AP's rule with its table of projections, or without one."""
    with mock.patch("env.downlink.power.MAX_TABLE", MAX_TABLE if tabled else 0):
        power = PowerConfig(levels=levels, resolve="project")
        return Downlink(EnvConfig(robots=robots, power=power))


def send(rule, picks, counts, gains):
    """What is sent for picks and falling gains in rank order, as levels and where dropped."""
    served = np.arange(np.shape(picks)[1]) < np.array(counts)[:, None]
    found = rule.allocate(np.array(gains), np.where(served, picks, 1), served)
    with np.errstate(divide="ignore"):
        levels = -np.log2(found.power_w / rule.max_power_w)
    return np.where(served, levels.round(), 0).astype(int).tolist(), found.margin_dropped.tolist()


def gaps_of(rule, gains):
    """The least p_k less all stronger powers, over P_max, at ranks 2..K."""
    return [rule.margin_w / rule.max_power_w / gain for gain in gains[:-1]]


@st.composite
def faint_slots(draw, robots, levels):
    """Picks by rank, how many are served, and falling gains that margins of some levels need."""
    pick, gain = st.integers(1, levels), st.floats(-11.5, -8).map(lambda x: 10**x)
    gains = sorted(draw(st.lists(gain, min_size=robots, max_size=robots)), reverse=True)
    picks = draw(st.lists(pick, min_size=robots, max_size=robots))
    return picks, draw(st.integers(0, robots)), gains


@given(problems())
def test_the_search_by_levels_finds_the_nearest_combination(case):
    picks, levels, _ = case
    assert project(picks, levels) == nearest(picks, levels)


@given(problems())
def test_with_margins_it_finds_the_nearest_one_that_keeps_them_or_none(case):
    picks, levels, gaps = case
    assert project(picks, levels, gaps) == nearest(picks, levels, gaps)


@given(problems())
def test_a_search_that_widens_step_by_step_and_row_by_row_finds_the_same(case):
    picks, levels, gaps = case
    with (
        mock.patch("env.downlink.power_search.FIRST_EXCESS", 1),
        mock.patch("env.downlink.power_search.MAX_CELLS", 1),
    ):
        assert project(picks, levels, gaps) == nearest(picks, levels, gaps)


def test_as_many_robots_and_levels_as_are_allowed_are_within_reach():
    generator = np.random.default_rng(0)
    picks = generator.integers(1, 49, size=(100, 48))
    count = generator.integers(0, 49, size=100)
    gaps = 10.0 ** generator.uniform(-14, -2, size=(100, 47))
    served = np.arange(48) < count[:, None]
    for least_gap in (None, gaps):
        found, feasible = project_levels(picks, count, 48, least_gap)
        assert 0 < feasible.sum() <= 100
        assert ((found > 0) == (served & feasible[:, None])).all()
        falls = found[:, :-1] > found[:, 1:]
        assert (falls | ~served[:, 1:])[feasible].all()
    power = fractions(found)
    margin = power[:, 1:] - np.cumsum(power, axis=1)[:, :-1]
    assert ((margin >= gaps) | ~served[:, 1:])[feasible].all()


@pytest.mark.parametrize(("robots", "levels"), [(2, 6), (3, 6), (4, 6)])
def test_every_pick_of_the_papers_settings_goes_to_its_nearest_combination(robots, levels):
    grid = np.stack(np.meshgrid(*[np.arange(1, levels + 1)] * robots), axis=-1)
    picks = grid.reshape(-1, robots)[:: 7 if robots == 4 else 1]
    found, feasible = project_levels(picks, np.full(len(picks), robots), levels)
    assert feasible.all()
    assert found.tolist() == [nearest(row, levels) for row in picks.tolist()]


def test_ties_go_to_the_smaller_total_power():
    # 2 2 is one step from both 3 2 and 2 1.
    assert project([2, 2], 6) == [3, 2]
    # 1 1 1 is three steps from 3 2 1 alone.
    assert project([1, 1, 1], 6) == [3, 2, 1]


def test_as_many_robots_as_levels_leave_one_combination():
    assert project([1, 6, 2, 5, 3, 4], 6) == [6, 5, 4, 3, 2, 1]


def test_a_margin_moves_the_projection_and_one_too_wide_leaves_none():
    assert project([3, 2], 6, [0.0]) == [3, 2]
    assert project([3, 2], 6, [0.125]) == [3, 2]  # 1/4 - 1/8, kept exactly
    assert project([3, 2], 6, [0.13]) == [4, 2]
    assert project([3, 2], 6, [NEVER]) is None


def test_rows_keep_to_themselves_whatever_their_counts():
    generator = np.random.default_rng(0)
    picks = generator.integers(1, 9, size=(60, 5))
    count = generator.integers(0, 6, size=60)
    gaps = generator.choice([0.0, 0.01, 0.05, 0.2], size=(60, 4))
    found, feasible = project_levels(picks, count, 8, gaps)
    for row in range(60):
        served = int(count[row])
        expected = nearest(picks[row, :served].tolist(), 8, gaps[row, : max(served - 1, 0)])
        assert feasible[row] == (expected is not None)
        assert found[row].tolist() == (expected or [0] * served) + [0] * (5 - served)
    assert 0 < feasible.sum() < 60


@pytest.mark.parametrize(("robots", "levels"), [(2, 6), (3, 6), (4, 6), (3, 12), (6, 12)])
@given(st.data())
@settings(max_examples=40)
def test_what_is_sent_is_nearest_with_or_without_a_table(robots, levels, data):
    """Under the margins of the channels; where no combination keeps them, without margins."""
    picks, count, gains = data.draw(faint_slots(robots, levels))
    tabled, searching = (downlink(robots, levels, which) for which in (True, False))
    gaps = gaps_of(tabled, gains)
    kept = nearest(picks[:count], levels, gaps[: max(count - 1, 0)])
    expected = (kept or nearest(picks[:count], levels)) + [0] * (robots - count)
    for either in (tabled, searching):
        found = send(either, [picks], [count], [gains])
        assert found == ([expected], [kept is None])


def test_where_no_combination_keeps_the_margin_it_is_dropped_for_that_row_alone():
    # Gaps of 2, 0.3 and 2 at the second rank; the last row serves one robot.
    gains = [[5e-12, 1e-12], [1e-11 / 0.3, 1e-12], [5e-12, 1e-12]]
    levels, dropped = send(downlink(2, 6), [[2, 2], [2, 2], [2, 1]], [2, 2, 1], gains)
    assert levels == [[3, 2], [3, 1], [2, 0]]
    assert dropped == [True, False, False]


def test_a_slot_leaves_no_trace_in_the_next():
    rule, strong, faint = downlink(2, 6), [[1e-6, 1e-7]], [[1e-11 / 0.3, 1e-12]]
    before = send(rule, [[2, 2]], [2], strong)
    assert send(rule, [[2, 2]], [2], faint) == ([[3, 1]], [False])
    assert send(rule, [[2, 2]], [2], strong) == before == ([[3, 2]], [False])


def test_a_level_is_a_halving_and_level_zero_is_nothing():
    assert fractions(np.array([0, 1, 2, 6])).tolist() == [0.0, 0.5, 0.25, 0.015625]


@given(st.lists(st.integers(0, 12), min_size=1, max_size=8))
def test_scaling_keeps_the_budget_and_the_shares(levels):
    asked = fractions(np.array(levels))
    sent = scaled_to_budget(asked)
    if asked.sum() <= 1:
        assert (sent == asked).all()
    else:
        assert sent.sum() == pytest.approx(1.0)
        assert sent == pytest.approx(asked / asked.sum())
