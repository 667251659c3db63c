"""The projection of picks onto feasible powers, against a search of all combinations."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env.power import MAX_TABLE, Projection, fractions, project_levels, scaled_to_budget

NEVER = 2.0


@st.composite
def problems(draw, fewest=6, most=6):
    """One row: picks by rank, N_P, and the least gap at each rank past the first."""
    ranks, count = draw(st.integers(1, most)), draw(st.integers(fewest, 12))
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


def without_table(projection):
    object.__setattr__(projection, "_table", None)
    return projection


@given(problems())
@settings(deadline=None, max_examples=150)
def test_the_search_by_levels_finds_the_nearest_combination(case):
    picks, levels, _ = case
    assert project(picks, levels) == nearest(picks, levels)


@given(problems())
@settings(deadline=None, max_examples=150)
def test_with_margins_it_finds_the_nearest_one_that_keeps_them_or_none(case):
    picks, levels, gaps = case
    assert project(picks, levels, gaps) == nearest(picks, levels, gaps)


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


@given(st.integers(0, 10_000), st.sampled_from([(2, 6), (3, 6), (4, 6), (3, 12)]))
@settings(deadline=None, max_examples=20)
def test_the_table_answers_as_the_search_does(seed, case):
    robots, levels = case
    generator = np.random.default_rng(seed)
    count = generator.integers(0, robots + 1, size=40)
    picks = generator.integers(1, levels + 1, size=(40, robots))
    picks = np.where(np.arange(robots) < count[:, None], picks, 0)
    gaps = generator.choice([0.0, 1e-3, 0.05, 0.2, NEVER], size=(40, robots - 1))
    tabled, searching = Projection(*case), without_table(Projection(*case))
    assert tabled._table is not None
    for found, expected in zip(
        tabled(picks, count, gaps), searching(picks, count, gaps), strict=True
    ):
        assert found.tolist() == expected.tolist()


@given(problems(fewest=12))
@settings(deadline=None, max_examples=40)
def test_many_robots_and_levels_are_projected_without_a_table(case):
    picks, levels, gaps = case
    picks, gaps = picks + [0] * (6 - len(picks)), gaps + [0.0] * (5 - len(gaps))
    count = len(case[0])
    projection = Projection(6, levels)
    assert (levels + 1) ** 6 > MAX_TABLE
    assert projection._table is None
    found, dropped = projection(np.array([picks]), np.array([count]), np.array([gaps]))
    kept = nearest(picks[:count], levels, gaps[: count - 1])
    assert dropped.tolist() == [kept is None]
    expected = kept or nearest(picks[:count], levels)
    assert found[0].tolist() == expected + [0] * (6 - count)


def test_where_no_combination_keeps_the_margin_it_is_dropped_for_that_row_alone():
    picks, count = np.array([[2, 2], [2, 2], [2, 0]]), np.array([2, 2, 1])
    levels, dropped = Projection(2, 6)(picks, count, np.array([[NEVER], [0.3], [NEVER]]))
    assert levels.tolist() == [[3, 2], [3, 1], [2, 0]]
    assert dropped.tolist() == [True, False, False]


def test_projecting_does_not_change_the_table():
    projection = Projection(2, 6)
    picks, count = np.array([[2, 2]]), np.array([2])
    projection(picks, count, np.array([[0.2]]))
    levels, _ = projection(picks, count, np.array([[0.0]]))
    assert levels.tolist() == [[3, 2]]


def test_a_level_is_a_halving_and_level_zero_is_nothing():
    assert fractions(np.array([0, 1, 2, 6])).tolist() == [0.0, 0.5, 0.25, 0.015625]


@given(st.lists(st.integers(0, 12), min_size=1, max_size=8))
@settings(deadline=None)
def test_scaling_keeps_the_budget_and_the_shares(levels):
    asked = fractions(np.array(levels))
    sent = scaled_to_budget(asked)
    if asked.sum() <= 1:
        assert (sent == asked).all()
    else:
        assert sent.sum() == pytest.approx(1.0)
        assert sent == pytest.approx(asked / asked.sum())
