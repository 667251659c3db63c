"""Rewards, energy and energy efficiency by hand, and a robot's action as one integer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env import actions
from env.config import MotionConfig, RewardConfig
from env.reward import (
    distance_m,
    energy_efficiency,
    global_reward,
    local_reward,
    motion_energy_j,
)


def test_motion_energy_of_eq_4_by_hand():
    # 100 s at 0.5 m/s are 50 m: 7.4 * 50 + 0.29 * 100.
    assert motion_energy_j(np.array([100.0, 0.0]), MotionConfig()) == pytest.approx([399.0, 0.0])


def test_the_distance_is_euclidean():
    assert distance_m(np.array([1.0, 1.0]), np.array([4.0, 5.0])) == pytest.approx(5.0)


def test_the_access_points_reward_of_eq_8_by_hand():
    assert global_reward(np.array([40.0]), RewardConfig()) == pytest.approx([4.0])
    weights = RewardConfig(global_offset=-10.0)
    assert global_reward(np.array([40.0]), weights) == pytest.approx([-6.0])


def test_a_robots_reward_of_eq_11_by_hand():
    rate, before, after = np.array([10.0, 10.0, 0.0]), np.array([5.0, 0.5, 3.0]), np.zeros(3)
    after[:] = 4.5, 0.0, 3.5
    arrived = np.array([False, True, False])
    found = local_reward(rate, before, after, arrived, RewardConfig())
    # 0.05 * 10 + 3 * 0.5 - 1; the same and 100; 3 * (-0.5) - 1.
    assert found == pytest.approx([1.0, 101.0, -2.5])


def test_the_rate_alone_does_not_pay_for_waiting():
    """R_time + phi R < 0 up to 20 bit/s/Hz, so that robots do not wander."""
    weights, here = RewardConfig(), np.array([7.0])
    nowhere = np.array([False])
    assert local_reward(np.array([19.9]), here, here, nowhere, weights) < 0
    assert local_reward(np.array([20.1]), here, here, nowhere, weights) > 0


def test_the_objective_5a_by_hand():
    rate_sum, slots = np.array([[30.0, 20.0]]), np.array([[10, 5]])
    # A slot of 1 s costs 3.99 J: 3 / 39.9 + 4 / 19.95.
    found = energy_efficiency(rate_sum, slots, 1.0, MotionConfig())
    assert found == pytest.approx([3 / 39.9 + 4 / 19.95])


def test_longer_slots_cost_energy_in_proportion():
    rate_sum, slots = np.array([30.0]), np.array([10])
    short = energy_efficiency(rate_sum, slots, 1.0, MotionConfig())
    assert energy_efficiency(rate_sum, slots, 2.0, MotionConfig()) == pytest.approx(short / 2)


@given(st.floats(0, 30), st.integers(1, 150), st.integers(1, 150))
@settings(deadline=None)
def test_at_the_same_mean_rate_a_longer_way_is_less_efficient(mean_rate, first, second):
    short, long = sorted((first, second))
    sums, slots = np.array([[mean_rate * short], [mean_rate * long]]), np.array([[short], [long]])
    found = energy_efficiency(sums, slots, 1.0, MotionConfig())
    assert found[0] >= found[1] * (1 - 1e-9)


def test_a_robot_has_four_directions_times_the_power_levels_of_actions():
    assert actions.count(6) == 24
    assert actions.encode(np.array(2), np.array(3), 6) == 14


@given(st.integers(1, 12))
@settings(deadline=None)
def test_actions_and_pairs_of_direction_and_level_are_one_to_one(levels):
    every = np.arange(actions.count(levels))
    direction, level = actions.decode(every, levels)
    assert (actions.encode(direction, level, levels) == every).all()
    assert set(direction.tolist()) == {0, 1, 2, 3}
    assert set(level.tolist()) == set(range(1, levels + 1))


def test_no_action_decodes_as_the_first():
    direction, level = actions.decode(np.array([-1, 0]), 6)
    assert (direction.tolist(), level.tolist()) == ([0, 0], [1, 1])
