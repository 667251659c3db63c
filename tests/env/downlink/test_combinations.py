"""Combinations of power levels: how many there are, in which order, and who gets which level."""

from math import comb

import numpy as np
import pytest

from env.checks import checked_config
from env.downlink.combinations import count_combinations, deal, levels_by_rank
from env.downlink.power import Projection
from env.downlink.power_search import project_levels


def test_of_four_levels_and_two_robots_there_are_six_combinations():
    config = checked_config({"robots": 2, "power": {"levels": 4}})
    assert count_combinations(config, 2) == 6
    assert levels_by_rank(config, 2, 2).tolist() == [[4, 3], [4, 2], [4, 1], [3, 2], [3, 1], [2, 1]]
    assert levels_by_rank(config, 2, 1).tolist() == [[4, 1], [3, 1], [2, 1], [1, 1]]


@pytest.mark.parametrize(
    ("changes", "count"),
    [
        ({}, 20),
        ({"power": {"levels": 3}}, 1),
        ({"power": {"resolve": "residual"}}, 216),
        ({"power": {"resolve": "zero", "levels": 2}}, 8),
        ({"access": "oma"}, 1),
        ({"access": "oma", "power": {"levels": 2}}, 1),
    ],
)
def test_as_many_are_listed_as_are_counted(changes, count):
    config = checked_config(changes)
    assert count_combinations(config, 3) == count
    assert levels_by_rank(config, 3, 3).shape == (count, 3)


def test_every_combination_is_sent_as_it_is_where_no_margin_is_asked():
    config = checked_config({"robots": 4, "power": {"levels": 8}})
    for served in range(1, 5):
        ranked = levels_by_rank(config, 4, served)
        assert len(ranked) == comb(8, served)
        picks = np.where(np.arange(4) < served, ranked, 0)
        sent, changed, _ = Projection(4, 8)(picks, np.zeros((len(picks), 3)))
        np.testing.assert_array_equal(sent, picks)
        assert not changed.any()


@pytest.mark.parametrize("margin", [0.0, 0.01])
def test_picks_that_are_a_combination_are_projected_as_all_others(margin):
    """Six robots of eight levels have more picks than are remembered."""
    draw = np.random.default_rng(0)
    fall = levels_by_rank(checked_config({"robots": 6, "power": {"levels": 8}}), 6, 6)
    picks = np.concatenate([draw.integers(1, 9, size=(100, 6)), fall])
    count = draw.integers(1, 7, size=len(picks))
    picks = np.where(np.arange(6) < count[:, None], picks, 0)
    least_gap = np.full((len(picks), 5), margin)
    sent, changed, dropped = Projection(6, 8)(picks, least_gap)
    expected, feasible = project_levels(np.maximum(picks, 1), count, 8, least_gap)
    np.testing.assert_array_equal(dropped, ~feasible)
    np.testing.assert_array_equal(sent[feasible], expected[feasible])
    np.testing.assert_array_equal(changed, (sent != picks).any(axis=-1))
    assert margin or not changed[100:].any()


def test_the_strongest_robot_gets_the_least_power_and_fewer_robots_the_last_levels():
    levels = np.tile([6, 4, 1], (5, 1))
    gain = np.tile([2.0, 3.0, 1.0], (5, 1))
    served = np.array(
        [
            [True, True, True],
            [True, False, True],
            [True, True, False],
            [False, True, False],
            [False, False, False],
        ]
    )
    expected = [[4, 6, 1], [4, 1, 1], [1, 4, 1], [1, 1, 1], [1, 1, 1]]
    np.testing.assert_array_equal(deal(levels, gain, served), expected)
