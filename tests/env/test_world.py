"""The world in motion: a hand-worked episode, arrivals, ends, batches, seeds, observations."""

import math
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env.config import (
    AccessPointConfig,
    ChannelConfig,
    EnvConfig,
    MotionConfig,
    OmaConfig,
    PowerConfig,
    RisConfig,
    RoomConfig,
    StateConfig,
    TasksConfig,
    WallsConfig,
)
from env.episode import EpisodeAccumulator
from env.local_env import LocalEnv
from env.mdp.destinations import draw_destinations
from env.radio.radio_map import build_radio_map
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World

NORTH, SOUTH, EAST, WEST = range(4)
VARIANTS = {
    "project": EnvConfig(robots=4),
    "residual": EnvConfig(robots=4, power=PowerConfig(resolve="residual")),
    "zero": EnvConfig(robots=4, power=PowerConfig(resolve="zero")),
    "subsurfaces": EnvConfig(robots=2, ris=RisConfig(side=12, subsurfaces=3)),
    "faint": EnvConfig(robots=4, ris=RisConfig(side=0), power=PowerConfig(max_dbm=0.0)),
    "literal": EnvConfig(robots=3, state=StateConfig(destination="none")),
    "weights": EnvConfig(robots=4, state=StateConfig(weights=True, order="gain")),
    "way": EnvConfig(robots=3, state=StateConfig(way="on")),
    "literal_way": EnvConfig(robots=3, state=StateConfig(destination="none", way="on")),
    "many": EnvConfig(robots=6, power=PowerConfig(levels=8)),
    "oma": EnvConfig(robots=4, access="oma"),
    "reallocate": EnvConfig(robots=4, access="oma", oma=OmaConfig(share="reallocate")),
    "qoe": EnvConfig(robots=4, metric="qoe"),
    "oma_qoe": EnvConfig(robots=7, access="oma", metric="qoe"),
    "common": EnvConfig(robots=4, tasks=TasksConfig(destination="common")),
}


def tiny(robots=2, **options):
    """A room of 6 x 6 cells without walls, surface or scattering: every rate is known."""
    options = {"motion": MotionConfig(max_slots=4), **options}
    return EnvConfig(
        robots=robots,
        room=RoomConfig(width_m=3.0, depth_m=3.0),
        walls=WallsConfig(segments=[]),
        ap=AccessPointConfig(position_m=[1.5, 3.0, 2.0]),
        ris=RisConfig(side=0, position_m=[3.0, 1.5, 2.0]),
        channel=ChannelConfig(rician_k_db=300.0),
        tasks=TasksConfig(start_distance_m=0.0),
        **options,
    )


def tiny_world(starts, destinations=(5, 0), **options):
    config = tiny(len(destinations), **options)
    world = World(Scenario(config, np.array(destinations)), stream(0, Stream.WORLD))
    world.reset(np.array([starts]))
    return world


def step(world, *moves, phase=0):
    """One slot of one world, each robot's move a (direction, level)."""
    direction, level = np.array(moves).T
    return world.step(np.array([phase]), direction[None], level[None])


def gain_at(x_m, y_m):
    distance_m = math.dist((x_m, y_m, 1.0), (1.5, 3.0, 2.0))
    loss_db = 32.4 + 17.3 * math.log10(distance_m) + 20 * math.log10(2.4)
    return 10 ** (-loss_db / 10)


def make(config, seed=0, worlds=1, radio_map=None):
    destinations = draw_destinations(config, stream(seed, Stream.DESTINATIONS))
    return World(Scenario(config, destinations, radio_map), stream(seed, Stream.WORLD), worlds)


def random_actions(world, generator):
    shape = world.cell.shape
    return (
        generator.integers(world.phase_actions, size=shape[0]),
        generator.integers(4, size=shape),
        generator.integers(1, world.config.power.levels + 1, size=shape),
    )


def snapshot(world, outcome):
    """All that a slot brings and leaves, as bytes per world."""
    allocation = outcome.allocation
    arrays = (
        outcome.rate, outcome.local_reward, outcome.global_reward, outcome.drove, outcome.arrived,
        outcome.terminated, outcome.truncated, allocation.rate, allocation.power_w,
        allocation.order, allocation.sic_failed, allocation.projected, allocation.margin_dropped,
        world.cell, world.driving, world.slot, world.local_observations(),
        world.global_observation(),
    )  # fmt: skip
    return [[array[b].tobytes() for array in arrays] for b in range(len(world.cell))]


def rollout(world, slots, seed=0):
    generator = np.random.default_rng(seed)
    return [snapshot(world, world.step(*random_actions(world, generator))) for _ in range(slots)]


# A hand-worked episode: robot 0 drives two cells east, robot 1 one cell west.

FIRST_GAINS = gain_at(1.75, 0.25), gain_at(0.75, 0.25)
FIRST_RATES = (
    math.log2(1 + FIRST_GAINS[0] * 0.1 / 16 / 1e-13),
    math.log2(1 + FIRST_GAINS[1] * 0.1 / 8 / (FIRST_GAINS[1] * 0.1 / 16 + 1e-13)),
)
SECOND_RATE = math.log2(1 + gain_at(2.25, 0.25) * 0.05 / 1e-13)


def test_the_first_slot_by_hand():
    world = tiny_world((3, 1))
    outcome = step(world, (EAST, 2), (WEST, 3))
    # Robot 0 is nearer to the AP. Levels 2 and 3 rise with the rank; of the feasible pairs at
    # distance two, 4 and 3 take the least power.
    assert outcome.allocation.order.tolist() == [[0, 1]]
    assert outcome.allocation.power_w[0] == pytest.approx([0.1 / 16, 0.1 / 8])
    assert outcome.allocation.projected.tolist() == [True]
    assert outcome.rate[0] == pytest.approx(FIRST_RATES)
    assert world.cell.tolist() == [[4, 0]]
    assert outcome.arrived.tolist() == [[False, True]]
    first = [0.05 * FIRST_RATES[0] + 3 * 0.5 - 1, 0.05 * FIRST_RATES[1] + 3 * 0.5 - 1 + 100]
    assert outcome.local_reward[0] == pytest.approx(first)
    assert outcome.global_reward == pytest.approx([0.1 * sum(FIRST_RATES)])
    assert (outcome.terminated.tolist(), outcome.truncated.tolist()) == ([False], [False])


def test_a_robot_that_has_arrived_takes_no_power_no_rate_and_no_step():
    world = tiny_world((3, 1))
    step(world, (EAST, 2), (WEST, 3))
    outcome = step(world, (EAST, 1), (NORTH, 1))
    assert outcome.drove.tolist() == [[True, False]]
    assert outcome.allocation.power_w[0] == pytest.approx([0.05, 0.0])
    assert outcome.rate[0] == pytest.approx([SECOND_RATE, 0.0])
    assert outcome.local_reward[0] == pytest.approx([0.05 * SECOND_RATE + 1.5 - 1 + 100, 0.0])
    assert outcome.global_reward == pytest.approx([0.1 * SECOND_RATE])
    assert world.cell.tolist() == [[5, 0]]
    assert outcome.arrived.tolist() == [[True, False]]
    assert (outcome.terminated.tolist(), outcome.truncated.tolist()) == ([True], [False])


def test_the_measures_of_the_episode_by_hand():
    world = tiny_world((3, 1))
    tally = EpisodeAccumulator(world)
    tally.add(step(world, (EAST, 2), (WEST, 3)))
    tally.add(step(world, (EAST, 1), (NORTH, 1)))
    found = tally.measures()
    near, far = FIRST_RATES[0] + SECOND_RATE, FIRST_RATES[1]
    assert found.success.tolist() == [1.0]
    assert found.path_ratio.tolist() == [[1.0, 1.0]]
    assert found.slots.tolist() == [2]
    assert found.reward == pytest.approx([0.05 * (near + far) + 3 * 1.5 - 3 + 200])
    # A slot costs 3.99 J; robot 0 drove two, robot 1 one.
    assert found.ee == pytest.approx([near / 2 / 7.98 + far / 1 / 3.99])
    assert found.ee_bits_per_joule == pytest.approx([(near + far) / (3 * 3.99)])
    assert found.sum_rate == pytest.approx([(near + far) / 2])
    assert found.min_rate == pytest.approx([min(near / 2, far)])
    assert found.projections.tolist() == [0.5]
    assert found.sic_violations.tolist() == [0.0]


def test_with_orthogonal_access_each_has_its_part_until_the_end_by_hand():
    world = tiny_world((3, 1), access="oma")
    first = step(world, (EAST, 2), (WEST, 3))
    rates = [math.log2(1 + gain * 0.05 / 0.5e-13) / 2 for gain in FIRST_GAINS]
    assert first.rate[0] == pytest.approx(rates)
    assert first.allocation.power_w.tolist() == [[0.05, 0.05]]
    second = step(world, (EAST, 1), (NORTH, 1))
    alone = math.log2(1 + gain_at(2.25, 0.25) * 0.1 / 1e-13)
    assert second.rate[0] == pytest.approx([alone / 2, 0.0])
    assert second.global_reward == pytest.approx([0.05 * alone])


def test_the_last_one_driving_gets_the_whole_band_where_parts_are_dealt_out_again():
    world = tiny_world((3, 1), access="oma", oma=OmaConfig(share="reallocate"))
    step(world, (EAST, 2), (WEST, 3))
    outcome = step(world, (EAST, 1), (NORTH, 1))
    alone = math.log2(1 + gain_at(2.25, 0.25) * 0.1 / 1e-13)
    assert outcome.rate[0] == pytest.approx([alone, 0.0])
    assert outcome.allocation.power_w[0] == pytest.approx([0.1, 0.0])


def test_quality_of_experience_replaces_the_rate_in_every_reward_by_hand():
    world = tiny_world((3, 1), metric="qoe")
    tally = EpisodeAccumulator(world)
    first = step(world, (EAST, 2), (WEST, 3))
    eta = [math.log10(rate) for rate in FIRST_RATES]
    assert first.rate[0] == pytest.approx(FIRST_RATES)
    expected = [0.05 * eta[0] + 1.5 - 1, 0.05 * eta[1] + 1.5 - 1 + 100]
    assert first.local_reward[0] == pytest.approx(expected)
    assert first.global_reward == pytest.approx([0.1 * sum(eta)])
    second = step(world, (EAST, 1), (NORTH, 1))
    # The robot that has arrived has no rate, and its floor does not count.
    assert second.global_reward == pytest.approx([0.1 * math.log10(SECOND_RATE)])
    tally.add(first)
    assert tally.measures().sum_rate == pytest.approx([sum(FIRST_RATES)])


def test_measures_of_a_detour_a_failure_and_signals_that_cannot_be_decoded():
    world = tiny_world((3, 12), power=PowerConfig(resolve="zero"))
    tally = EpisodeAccumulator(world)
    for direction in (SOUTH, SOUTH, EAST, EAST):
        outcome = step(world, (direction, 1), (EAST, 1))
        tally.add(outcome)
    found = tally.measures()
    assert found.success.tolist() == [0.5]
    assert found.path_ratio[0, 0] == 2.0  # four slots where two would do
    assert math.isnan(found.path_ratio[0, 1])
    assert found.sic_violations.tolist() == [0.5]  # one of two equal signals, in every slot
    assert found.projections.tolist() == [0.0]
    assert found.min_rate[0] < found.sum_rate[0]
    assert outcome.truncated.tolist() == [True]
    summary = found.summary()
    assert summary["path_ratio"] == 2.0
    assert summary["success"] == 0.5
    assert summary["slots"] == 4.0


def test_a_summary_without_arrivals_has_no_path_ratio():
    world = tiny_world((3, 1))
    tally = EpisodeAccumulator(world)
    tally.add(step(world, (NORTH, 1), (NORTH, 2)))
    assert math.isnan(tally.measures().summary()["path_ratio"])


def test_measures_of_some_worlds_are_those_worlds_own():
    world = make(VARIANTS["project"], worlds=3)
    world.reset()
    tally = EpisodeAccumulator(world)
    generator = np.random.default_rng(0)
    for _ in range(5):
        tally.add(world.step(*random_actions(world, generator)))
    every, last = tally.measures(), tally.measures().of(slice(2, 3))
    assert last.ee.tolist() == every.ee[2:].tolist()
    assert last.path_ratio.shape == (1, 4)


# Moves and ends.


@pytest.mark.parametrize(("start", "direction"), [(3, SOUTH), (33, NORTH), (12, WEST), (17, EAST)])
def test_a_move_out_of_the_room_stays_put_and_costs_its_time(start, direction):
    world = tiny_world((start,), destinations=(20,))
    outcome = step(world, (direction, 1))
    assert world.cell.tolist() == [[start]]
    assert outcome.local_reward[0] == pytest.approx(0.05 * outcome.rate[0] - 1.0)
    assert outcome.rate[0, 0] > 0


def test_robots_may_share_a_cell():
    world = tiny_world((3, 1), destinations=(5, 30))
    step(world, (WEST, 1), (EAST, 2))
    assert world.cell.tolist() == [[2, 2]]


def test_time_runs_out_after_t_max_slots_and_not_before():
    world = tiny_world((3, 1), motion=MotionConfig(max_slots=3))
    ends = [step(world, (SOUTH, 1), (SOUTH, 2)) for _ in range(3)]
    assert [end.truncated.tolist() for end in ends] == [[False], [False], [True]]
    assert not any(end.terminated.any() for end in ends)


def test_arriving_in_the_last_slot_is_an_arrival_and_no_timeout():
    world = tiny_world((3, 1), motion=MotionConfig(max_slots=2))
    step(world, (EAST, 2), (WEST, 3))
    end = step(world, (EAST, 2), (WEST, 3))
    assert (end.terminated.tolist(), end.truncated.tolist()) == ([True], [False])


def test_a_world_that_has_ended_stands_still_while_others_go_on():
    world = tiny_world((4, 1), destinations=(5, 0))
    world.reset(np.array([[4, 1], [3, 30]]))
    both = np.array([[EAST, WEST], [EAST, SOUTH]]), np.array([[1, 2], [1, 2]])
    assert world.step(np.zeros(2, dtype=int), *both).terminated.tolist() == [True, False]
    after = world.step(np.zeros(2, dtype=int), *both)
    assert world.cell[0].tolist() == [5, 0]
    assert world.slot.tolist() == [1, 2]
    assert after.rate[0].tolist() == [0.0, 0.0]
    assert after.local_reward[0].tolist() == [0.0, 0.0]
    assert (after.rate[1] > 0).all()


def test_channels_are_those_of_the_cells_that_are_left():
    config = EnvConfig(robots=1)
    world = make(config)
    world.reset(np.array([[100]]))
    outcome = world.step(np.array([2]), np.array([[EAST]]), np.array([[1]]))
    gain = abs(world.radio_map.channel(np.array([[100]]), np.array([2]))[0, 0]) ** 2
    assert outcome.rate[0, 0] == pytest.approx(math.log2(1 + gain * 0.05 / 1e-13))
    assert world.cell.tolist() == [[101]]


# Starts.


def test_starts_are_at_least_ten_metres_from_the_destination_and_spread_over_the_room():
    world = make(EnvConfig(robots=4))
    starts = world.draw_starts(2000)
    centres = world.floor.centres()
    apart = np.linalg.norm(centres[starts] - centres[world.destinations], axis=-1)
    assert apart.min() >= 10.0
    assert apart.min() < 10.6
    for k in range(4):
        allowed = np.linalg.norm(centres - centres[world.destinations[k]], axis=-1) >= 10.0
        assert len({*starts[:, k].tolist()}) > 0.4 * allowed.sum()


def test_a_reset_draws_for_every_world_and_sets_clock_and_robots_going():
    world = make(EnvConfig(robots=2), worlds=50)
    world.reset()
    first = world.cell.copy()
    rollout(world, 3)
    world.reset()
    assert (world.slot == 0).all()
    assert world.driving.all()
    assert (world.cell != first).mean() > 0.9


def test_fixed_starts_are_those_of_the_configuration_and_draw_nothing():
    starts = [[0.25, 0.25], [29.75, 29.75], [3.0, 4.0]]
    world = make(EnvConfig(robots=2, tasks=TasksConfig(start="fixed", starts_m=starts)), worlds=3)
    world.reset()
    assert world.cell.tolist() == [[0, 3599]] * 3
    assert world.generator.random() == stream(0, Stream.WORLD).random()


def test_robots_with_one_destination_all_arrive_there():
    world = make(VARIANTS["common"])
    goal = int(world.destinations[0])
    assert world.destinations.tolist() == [goal] * 4
    world.reset(np.array([[goal - 1, goal + 1, goal - 60, goal + 60]]))
    outcome = step(world, (EAST, 1), (WEST, 2), (NORTH, 3), (SOUTH, 4))
    assert outcome.arrived.all()
    assert outcome.terminated.all()


# Batches, seeds, generators.


@pytest.mark.parametrize("variant", [*VARIANTS])
def test_worlds_stepped_together_equal_worlds_stepped_alone_bit_by_bit(variant):
    config, worlds, slots = VARIANTS[variant], 7, 40
    radio_map = build_radio_map(config)
    together = make(config, worlds=worlds, radio_map=radio_map)
    together.reset()
    starts, generator = together.cell.copy(), np.random.default_rng(1)
    # Some robots start beside their destination, so that arrivals are among the slots.
    starts[::2, 0] = together.destinations[0] - 1
    together.reset(starts)
    played = [random_actions(together, generator) for _ in range(slots)]
    found = [snapshot(together, together.step(*actions)) for actions in played]
    assert not together.driving.all()
    for b in range(worlds):
        alone = make(config, radio_map=radio_map)
        alone.reset(starts[b : b + 1])
        for actions, expected in zip(played, found, strict=True):
            outcome = alone.step(*(part[b : b + 1] for part in actions))
            assert snapshot(alone, outcome)[0] == expected[b]


@given(st.integers(0, 1000))
@settings(max_examples=8)
def test_a_seed_fixes_the_trajectories(seed):
    config = EnvConfig(robots=3)
    radio_map = build_radio_map(config)
    runs = []
    for _ in range(2):
        world = make(config, seed, worlds=2, radio_map=radio_map)
        world.reset()
        runs.append((world.cell.tobytes(), rollout(world, 5, seed)))
        world.reset()
        runs[-1] += (world.cell.tobytes(),)
    assert runs[0] == runs[1]
    other = make(config, seed + 1, worlds=2, radio_map=radio_map)
    other.reset()
    assert other.cell.tobytes() != runs[0][0]


def test_a_world_touches_no_global_generator():
    before, legacy = random.getstate(), np.random.get_state()  # noqa: NPY002
    world = make(EnvConfig(robots=3), worlds=3)
    world.reset()
    rollout(world, 3)
    after = np.random.get_state()  # noqa: NPY002
    assert random.getstate() == before
    assert after[2] == legacy[2]
    assert (after[1] == legacy[1]).all()


def test_stepping_draws_nothing_from_the_worlds_stream():
    first, second = make(EnvConfig(robots=2)), make(EnvConfig(robots=2))
    for world in (first, second):
        world.reset()
    rollout(first, 10)
    first.reset()
    second.reset()
    assert (first.cell == second.cell).all()


# Observations.


def test_a_robots_observation_by_hand():
    world = make(EnvConfig(robots=2))
    world.reset(np.array([[0, 3599]]))
    db = 20 * np.log10(np.abs(world.radio_map.direct[[0, 3599]]))
    found = world.local_observations()
    assert found.dtype == np.float32
    low, high = 0.25 / 15 - 1, 29.75 / 15 - 1
    first = [low, low, (db[0] + 70) / 20, (27.25 - 0.25) / 30, (12.25 - 0.25) / 30]
    second = [high, high, (db[1] + 70) / 20, (4.25 - 29.75) / 30, (10.25 - 29.75) / 30]
    assert found[0, 0] == pytest.approx(first, abs=1e-6)
    assert found[0, 1] == pytest.approx(second, abs=1e-6)


def test_without_the_destination_the_state_is_that_of_the_paper():
    world = make(VARIANTS["literal"])
    world.reset(np.array([[0, 100, 3599]]))
    offset = make(EnvConfig(robots=3))
    offset.reset(np.array([[0, 100, 3599]]))
    found = world.local_observations()
    assert found.shape == (1, 3, 3)
    assert (found == offset.local_observations()[..., :3]).all()
    assert world.global_observation().shape == (1, 18)


def test_the_access_points_observation_by_hand():
    world = make(EnvConfig(robots=2))
    world.reset(np.array([[0, 3599]]))
    found = world.global_observation().reshape(2, 8)
    local = world.local_observations()[0]
    for k, cell in enumerate((0, 3599)):
        angle = np.angle(world.radio_map.direct[cell])
        expected = [*local[k, :3], math.cos(angle), math.sin(angle), 1.0, *local[k, 3:]]
        assert found[k] == pytest.approx(expected, abs=1e-6)


def test_the_access_point_sees_zeros_for_a_robot_that_has_arrived():
    world = tiny_world((3, 1))
    step(world, (EAST, 2), (WEST, 3))
    found = world.global_observation().reshape(2, 8)
    assert found[0, 5] == 1.0
    assert found[0, :3].any()
    assert found[1].tolist() == [0.0] * 8


def test_the_access_point_sees_weights_by_hand():
    world = tiny_world((3, 1, 30), (5, 0, 32), state=StateConfig(weights=True))
    plain = tiny_world((3, 1, 30), (5, 0, 32))
    step(world, (NORTH, 2), (WEST, 3), (EAST, 1))
    step(plain, (NORTH, 2), (WEST, 3), (EAST, 1))
    # After a slot robot 0 has three left, robot 2 one; robot 1 has arrived: (1/4)^2 to (1/2)^2.
    found = world.global_observation().reshape(3, 9)
    assert found[:, 8].tolist() == pytest.approx([0.2, 0.0, 0.8])
    assert found[:, :8].tobytes() == plain.global_observation().tobytes()
    assert world.observer.global_size == 27


def test_the_access_point_sees_robots_by_their_channels():
    starts, destinations = (1, 33, 3, 32), (0, 0, 5, 5)
    world = tiny_world(starts, destinations, state=StateConfig(order="gain", weights=True))
    index = tiny_world(starts, destinations, state=StateConfig(weights=True))
    gains = [gain_at(*world.floor.centres()[cell]) for cell in starts]
    # Cells 33 and 32 lie beside the AP on both sides: equals stand by index.
    order = [1, 3, 2, 0]
    assert gains[1] == pytest.approx(gains[3])
    world.radio_map.direct[32] = index.radio_map.direct[32] = world.radio_map.direct[33]
    expected = index.global_observation().reshape(4, 9)[order]
    assert world.global_observation().reshape(4, 9).tobytes() == expected.tobytes()
    world.driving[0, 1] = index.driving[0, 1] = False
    expected = index.global_observation().reshape(4, 9)[[3, 2, 0, 1]]
    assert world.global_observation().reshape(4, 9).tobytes() == expected.tobytes()
    assert not expected[3].any()


@given(st.integers(0, 1000), st.integers(1, 6))
@settings(max_examples=15, deadline=None)
def test_in_any_order_the_access_point_sees_the_same_robots(seed, robots):
    state = {"weights": True, "destination": "none"}
    worlds = [
        make(EnvConfig(robots=robots, state=StateConfig(order=order, **state)), seed, worlds=3)
        for order in ("index", "gain")
    ]
    for world in worlds:
        world.reset()
        world.driving[:, 0] = robots == 1
    rows, sorted_rows = (world.global_observation().reshape(3, robots, 7) for world in worlds)
    assert sorted_rows.shape == rows.shape
    counts = worlds[0].driving.sum(axis=-1)
    for by_index, by_gain, count in zip(rows, sorted_rows, counts, strict=True):
        assert sorted(map(tuple, by_index)) == sorted(map(tuple, by_gain))
        assert (np.diff(by_gain[:count, 2]) <= 0).all()  # the channel in dB falls
        assert by_gain[:count, 6].sum() == pytest.approx(1.0, abs=1e-6)


def test_positions_are_scaled_to_a_room_of_any_shape():
    config = EnvConfig(
        robots=1,
        room=RoomConfig(width_m=20.0, depth_m=10.0),
        walls=WallsConfig(segments=[]),
        ap=AccessPointConfig(position_m=[10.0, 10.0, 2.0]),
        ris=RisConfig(position_m=[20.0, 5.0, 2.0]),
        tasks=TasksConfig(destinations_m=[[19.75, 0.25]]),
    )
    world = make(config)
    world.reset(np.array([[0]]))
    found = world.local_observations()[0, 0]
    assert found[[0, 1, 3, 4]] == pytest.approx([-0.975, -0.95, 0.975, 0.0])


# A robot's slice.


@pytest.mark.parametrize(
    "variant",
    ["project", "zero", "literal", "way", "literal_way", "many", "qoe", "oma_qoe", "common"],
)
def test_a_slice_makes_the_worlds_observation_and_reward_bit_by_bit(variant):
    config = VARIANTS[variant]
    world = make(config)
    world.reset()
    start = world.cell.copy()
    start[0, 0] = world.destinations[0] - 1
    world.reset(start)
    everybody = LocalEnv(Scenario(config, world.destinations))
    single = [
        LocalEnv(Scenario(config, world.destinations[k : k + 1])) for k in range(world.robots)
    ]
    assert everybody.observation_size == world.observer.local_size
    generator, arrivals = np.random.default_rng(2), 0
    for slot in range(60):
        left = world.cell[0].astype(np.int32)
        measured = world.radio_map.direct_db[left]
        seen = world.local_observations()[0]
        assert everybody.observe(left, measured).tobytes() == seen.tobytes()
        phase, direction, level = random_actions(world, generator)
        if slot == 0:
            direction[0, 0] = EAST
        outcome = world.step(phase, direction, level)
        arrivals += int(outcome.arrived.sum())
        told = (outcome.rate[0], left, world.cell[0].astype(np.int32), outcome.arrived[0])
        drove = outcome.drove[0]
        made = everybody.reward(*told)
        assert made[drove].tobytes() == outcome.local_reward[0, drove].tobytes()
        for k in np.flatnonzero(drove):
            alone = single[k].reward(*(part[k : k + 1] for part in told))
            assert alone[0] == outcome.local_reward[0, k]
            mine = single[k].observe(left[k : k + 1], measured[k : k + 1])
            assert mine.tobytes() == seen[k].tobytes()
    assert arrivals
