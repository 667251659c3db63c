"""What robots are credited with and what rates weigh, by hand and by leaving signals out."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env.checks import checked_config
from env.local_env import LocalEnv
from env.mdp.reward import metric
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World

NORTH, SOUTH, EAST, WEST = range(4)
TINY: dict[str, Any] = {
    "robots": 2,
    "room": {"width_m": 3.0, "depth_m": 3.0},
    "walls": {"segments": []},
    "ap": {"position_m": [1.5, 3.0, 2.0]},
    "ris": {"side": 0, "position_m": [3.0, 1.5, 2.0]},
    "channel": {"rician_k_db": 300.0},
    "tasks": {
        "destinations_m": [[2.75, 0.25], [0.25, 0.25]],
        "start_distance_m": 0.0,
        "destination_spacing_m": 0.5,
    },
}
"""6 x 6 cells without walls, surface or scattering; robots go to the south-east and south-west."""


def gain_at(x_m, y_m):
    distance_m = math.dist((x_m, y_m, 1.0), (1.5, 3.0, 2.0))
    loss_db = 32.4 + 17.3 * math.log10(distance_m) + 20 * math.log10(2.4)
    return 10 ** (-loss_db / 10)


# Robot 0 starts in cell 3, two slots from its destination, robot 1 in cell 1, one slot from its
# own. Robot 0 is the stronger one: its signal disturbs that of robot 1.
STRONG, WEAK = gain_at(1.75, 0.25), gain_at(0.75, 0.25)
RATES = (
    math.log2(1 + STRONG * 0.1 / 16 / 1e-13),
    math.log2(1 + WEAK * 0.1 / 8 / (WEAK * 0.1 / 16 + 1e-13)),
)
WEAK_ALONE = math.log2(1 + WEAK * 0.1 / 8 / 1e-13)
WEIGHTS = (4.0, 16.0)  # (4 / 2)^2 and (4 / 1)^2


def world_of(config, seed=0, worlds=1):
    return World(Scenario.drawn(config, seed), stream(seed, Stream.WORLD), worlds)


def tiny_slot(reward, **changes):
    """The world after the first slot, and what that brought."""
    reward = {"horizon_slots": 4.0, **reward}
    world = world_of(checked_config({**TINY, **changes, "reward": reward}))
    world.reset(np.array([[3, 1]]))
    moves = np.array([[EAST, WEST]]), np.array([[2, 3]])
    return world, world.step(np.zeros(1, dtype=int), *moves)


def test_a_robots_slots_are_those_so_far_and_the_shortest_way_left():
    world = world_of(checked_config(TINY))
    world.reset(np.array([[3, 1]]))
    assert world.travel_slots.tolist() == [[2, 1]]
    levels = np.array([[2, 3]])
    world.step(np.zeros(1, dtype=int), np.array([[EAST, NORTH]]), levels)
    assert world.travel_slots.tolist() == [[2, 3]]  # robot 1 went away from its destination
    world.step(np.zeros(1, dtype=int), np.array([[SOUTH, NORTH]]), levels)
    assert world.travel_slots.tolist() == [[3, 5]]  # robot 0 stayed put
    world.reset(np.array([[5, 1]]))
    assert world.travel_slots.tolist() == [[1, 1]]


CREDITS = {
    "rate": RATES,
    "team": (RATES[0] + 4 * RATES[1], RATES[0] / 4 + RATES[1]),
    "difference": (RATES[0] - 4 * (WEAK_ALONE - RATES[1]), RATES[1]),
}


@pytest.mark.parametrize("credit", [*CREDITS])
def test_a_slots_credit_by_hand(credit):
    world, outcome = tiny_slot({"credit": credit})
    assert outcome.rate[0] == pytest.approx(RATES)
    assert outcome.credit[0] == pytest.approx(CREDITS[credit])
    first, second = (0.05 * each + 3 * 0.5 - 1 for each in CREDITS[credit])
    assert outcome.local_reward[0] == pytest.approx([first, second + 100])
    assert outcome.global_reward == pytest.approx([0.1 * sum(RATES)])
    # Robot 1 has arrived: robot 0 is alone.
    outcome = world.step(np.zeros(1, dtype=int), np.array([[EAST, WEST]]), np.array([[1, 1]]))
    assert outcome.credit[0] == pytest.approx([outcome.rate[0, 0], 0.0])


def test_with_the_rate_as_credit_the_two_are_one_array():
    outcome = tiny_slot({})[1]
    assert outcome.credit is outcome.rate


def test_under_orthogonal_access_a_robots_absence_takes_its_own_rate_alone():
    difference = tiny_slot({"credit": "difference"}, access="oma")[1]
    assert difference.credit.tolist() == difference.rate.tolist()


def test_credit_counts_the_quality_where_rewards_do():
    outcome = tiny_slot({"credit": "difference"}, metric="qoe")[1]
    eta = [math.log10(rate) for rate in (*RATES, WEAK_ALONE)]
    expected = [eta[0] - 4 * (eta[2] - eta[1]), eta[1]]
    assert outcome.credit[0] == pytest.approx(expected)
    assert outcome.local_reward[0, 0] == pytest.approx(0.05 * expected[0] + 0.5)


def test_the_access_points_reward_weighs_rates_by_hand():
    world, outcome = tiny_slot({"weights": "objective"})
    expected = 0.1 * 2 * (4 * RATES[0] + 16 * RATES[1]) / 20
    assert outcome.global_reward == pytest.approx([expected])
    assert outcome.credit[0] == pytest.approx(RATES)
    last = world.step(np.zeros(1, dtype=int), np.array([[EAST, WEST]]), np.array([[1, 1]]))
    assert last.global_reward == pytest.approx([0.1 * last.rate[0, 0]])
    over = world.step(np.zeros(1, dtype=int), np.array([[EAST, WEST]]), np.array([[1, 1]]))
    assert over.global_reward.tolist() == [0.0]


def test_the_worlds_weights_are_those_of_the_access_points_reward():
    world = world_of(checked_config({**TINY, "reward": {"weights": "objective"}}))
    world.reset(np.array([[3, 1]]))
    assert world.rate_weights.tolist() == [[400.0, 1600.0]]
    equal = world_of(checked_config({**TINY, "reward": {"credit": "team"}}))
    equal.reset(np.array([[3, 1]]))
    assert equal.rate_weights.tolist() == [[1.0, 1.0]]
    assert equal.rate_weights.dtype == np.float64


@given(st.integers(0, 10_000), st.integers(1, 6), st.sampled_from(["qos", "qoe"]), st.floats(0, 20))
@settings(max_examples=30, deadline=None)
def test_the_difference_is_that_of_slots_with_and_without_a_signal(seed, robots, counted, power):
    """Rates are summed once more from powers and channels, robot by robot, without a table."""
    changes = {"reward": {"credit": "difference"}, "metric": counted, "power": {"max_dbm": power}}
    config = checked_config({"robots": robots, "ris": {"side": 4}, **changes})
    world = world_of(config, seed)
    world.reset()
    picks = np.random.default_rng(seed)
    if robots > 1:
        world.driving[0, 0] = False
    gain, weights = world.radio_map.gain(world.cell, np.array([1])), (40 / world.travel_slots) ** 2
    drove = world.driving[0]
    outcome = world.step(
        np.array([1]), picks.integers(4, size=(1, robots)), picks.integers(1, 7, size=(1, robots))
    )

    def total(served):
        """The weighted sum of the metric over some robots, by the definition of the rates."""
        order = [k for k in outcome.allocation.order[0] if k in served]
        value, interference = 0.0, 0.0
        for k in order:
            p = outcome.allocation.power_w[0, k]
            noise = world.downlink.noise_w
            rate = np.log2(1 + gain[0, k] * p / (gain[0, k] * interference + noise))
            value += weights[0, k] * metric(rate, config)
            interference += p
        return value

    served = set(np.flatnonzero(drove))
    expected = [
        (total(served) - total(served - {k})) / weights[0, k] if drove[k] else 0.0
        for k in range(robots)
    ]
    assert outcome.credit[0] == pytest.approx(expected, rel=1e-9, abs=1e-7)


@pytest.mark.parametrize("credit", [*CREDITS])
def test_a_robot_makes_the_worlds_reward_of_its_credit_bit_by_bit(credit):
    reward = {"credit": credit, "guidance_discount": 0.8, "weights": "objective"}
    config = checked_config({"robots": 4, "reward": reward, "motion": {"max_slots": 60}})
    world, picks = world_of(config), np.random.default_rng(0)
    world.reset()
    start = world.cell.copy()
    start[0, 0] = world.destinations[0] - 1
    world.reset(start)
    robots = LocalEnv(Scenario(config, world.destinations))
    for _ in range(40):
        left = world.cell[0].astype(np.int32)
        outcome = world.step(
            np.array([0]), picks.integers(4, size=(1, 4)), picks.integers(1, 7, size=(1, 4))
        )
        reached, drove = world.cell[0].astype(np.int32), outcome.drove[0]
        made = robots.reward(outcome.credit[0], left, reached, outcome.arrived[0])
        assert made[drove].tobytes() == outcome.local_reward[0, drove].tobytes()


def test_worlds_credited_together_equal_worlds_credited_alone_bit_by_bit():
    reward = {"credit": "difference", "weights": "objective"}
    config = checked_config({"robots": 4, "reward": reward})
    together, alone = world_of(config, worlds=5), world_of(config)
    together.reset()
    start, picks = together.cell.copy(), np.random.default_rng(3)
    shape = start.shape
    played = [
        (picks.integers(4, size=5), picks.integers(4, size=shape), picks.integers(1, 7, size=shape))
        for _ in range(10)
    ]
    found = [together.step(*actions) for actions in played]
    for b in range(5):
        alone.reset(start[b : b + 1])
        for actions, expected in zip(played, found, strict=True):
            outcome = alone.step(*(part[b : b + 1] for part in actions))
            assert outcome.credit[0].tobytes() == expected.credit[b].tobytes()
            assert outcome.global_reward[0] == expected.global_reward[b]
