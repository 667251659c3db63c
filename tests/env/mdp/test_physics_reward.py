"""Rewards, energy and energy efficiency by hand, and a robot's action as one integer."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from env.config import EnvConfig, MotionConfig, QoeConfig, RewardConfig
from env.geometry.distances import distance_m
from env.mdp.actions import ActionSpace
from env.mdp.reward import (
    bits_per_joule,
    energy_efficiency,
    global_reward,
    local_reward,
    metric,
    motion_energy_j,
    quality_of_experience,
    rate_weights,
    shares,
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


def test_a_discount_of_the_guidance_weighs_the_distance_after_the_move():
    before, after, nowhere = np.array([5.0]), np.array([4.5]), np.array([False])
    weights = RewardConfig(guidance_discount=0.8)
    # 0.05 * 10 + 3 * (5 - 0.8 * 4.5) - 1.
    assert local_reward(np.array([10.0]), before, after, nowhere, weights) == pytest.approx([3.7])


@given(st.lists(st.floats(0, 40), min_size=2, max_size=30), st.floats(0.5, 1))
def test_with_the_robots_discount_the_guidance_depends_on_start_and_end_alone(way_m, discount):
    """Summed with the same discount, what lies between a start and a destination cancels."""
    way = np.array([*way_m, 0.0])
    weights = RewardConfig(rate=0.0, time=0.0, guidance_discount=discount)
    paid = local_reward(np.zeros(len(way) - 1), way[:-1], way[1:], np.array(False), weights)
    discounted = paid * discount ** np.arange(len(paid))
    assert discounted.sum() == pytest.approx(3.0 * way[0], abs=1e-9)


def test_rates_weigh_as_the_objective_counts_them():
    assert rate_weights(np.array([40, 20, 80]), 40.0).tolist() == [1.0, 4.0, 0.25]
    # Twice the slots is a quarter of 1 / (T_k E_k).
    slots = np.array([[40], [20], [80]])
    found = energy_efficiency(np.ones((3, 1)), slots, 1.0, MotionConfig())
    assert found / found[0] == pytest.approx([1.0, 4.0, 0.25])


def test_shares_are_of_those_that_drive():
    driving = np.array([[True, False, True], [False, False, False]])
    found = shares(np.array([[1.0, 5.0, 3.0]] * 2), driving)
    assert found.tolist() == [[0.25, 0.0, 0.75], [0.0, 0.0, 0.0]]


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


def test_bits_per_joule_by_hand():
    rate_sum, slots = np.array([[30.0, 20.0]]), np.array([[10, 5]])
    # 50 bit/s/Hz over 1 Hz and slots of 2 s are 100 bit; 15 slots cost 15 * 2 * 3.99 J.
    found = bits_per_joule(rate_sum, slots, 2.0, 1.0, MotionConfig())
    assert found == pytest.approx([100 / 119.7])
    wide = bits_per_joule(rate_sum, slots, 2.0, 1e6, MotionConfig())
    assert wide == pytest.approx(found * 1e6)


@given(st.floats(0, 30), st.lists(st.integers(1, 150), min_size=1, max_size=5))
def test_bits_per_joule_at_one_rate_do_not_depend_on_the_length_of_ways(rate, driven):
    slots = np.array([driven])
    found = bits_per_joule(rate * slots, slots, 1.0, 1.0, MotionConfig())
    assert found == pytest.approx([rate / 3.99])


def test_quality_of_experience_of_baseline_3_by_hand():
    rate = np.array([10.0, 1.0, 0.001, 0.0])
    assert quality_of_experience(rate, QoeConfig()) == pytest.approx([1.0, 0.0, -2.0, -2.0])
    found = quality_of_experience(rate, QoeConfig(scale=2.0, offset=3.0, floor=0.1))
    assert found == pytest.approx([5.0, 3.0, 1.0, 1.0])


@given(st.floats(0, 40), st.floats(0, 40))
def test_quality_never_falls_with_the_rate(first, second):
    low, high = sorted((first, second))
    found = quality_of_experience(np.array([low, high]), QoeConfig())
    assert found[0] <= found[1]


@given(st.integers(0, 2**32), st.integers(1, 40))
def test_the_bits_of_the_quality_do_not_depend_on_what_lies_around_a_rate(seed, count):
    """A robot works its reward out from one field of a message, the world from an array of all."""
    rate = np.random.default_rng(seed).exponential(5.0, size=count)
    message = np.zeros(count, dtype=[("flag", "u1"), ("rate", "f8")])
    message["rate"] = rate
    together = quality_of_experience(rate, QoeConfig())
    assert quality_of_experience(message["rate"], QoeConfig()).tobytes() == together.tobytes()
    alone = [quality_of_experience(rate[k : k + 1], QoeConfig())[0] for k in range(count)]
    assert together.tolist() == alone


def test_rewards_are_made_of_the_rate_unless_the_metric_is_quality():
    rate = np.array([10.0, 100.0])
    assert metric(rate, EnvConfig()) is rate
    assert metric(rate, EnvConfig(metric="qoe")) == pytest.approx([1.0, 2.0])


@given(st.floats(0, 30), st.integers(1, 150), st.integers(1, 150))
def test_at_the_same_mean_rate_a_longer_way_is_less_efficient(mean_rate, first, second):
    short, long = sorted((first, second))
    sums, slots = np.array([[mean_rate * short], [mean_rate * long]]), np.array([[short], [long]])
    found = energy_efficiency(sums, slots, 1.0, MotionConfig())
    assert found[0] >= found[1] * (1 - 1e-9)


def test_a_robot_has_four_directions_times_the_power_levels_of_actions():
    assert ActionSpace(6).count == 24
    # 14 = 2 * 6 + 3 - 1: east, at the third level.
    assert ActionSpace(6).encode(np.array(2), np.array(3)) == 14
    assert ActionSpace(6).decode(np.array(14)) == (2, 3)


@given(st.integers(1, 12))
def test_actions_and_pairs_of_direction_and_level_are_one_to_one(levels):
    every = np.arange(ActionSpace(levels).count)
    direction, level = ActionSpace(levels).decode(every)
    assert (ActionSpace(levels).encode(direction, level) == every).all()
    assert set(direction.tolist()) == {0, 1, 2, 3}
    assert set(level.tolist()) == set(range(1, levels + 1))


def test_no_action_decodes_as_the_first():
    direction, level = ActionSpace(6).decode(np.array([-1, 0]))
    assert (direction.tolist(), level.tolist()) == ([0, 0], [1, 1])
