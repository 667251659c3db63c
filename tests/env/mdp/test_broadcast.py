"""What the access point tells robots of each other, and states made of it on the robots' side."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env.apis.single_robot import SingleRobotEnv
from env.checks import checked_config
from env.local_env import LocalEnv
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World


def world_of(changes, seed=0, worlds=1):
    config = checked_config(changes)
    world = World(Scenario.drawn(config, seed), stream(seed, Stream.WORLD), worlds)
    world.reset()
    return world


def play(world, picks):
    """One slot with actions at random."""
    shape = world.cell.shape
    phase = picks.integers(world.phase_actions, size=shape[0])
    return world.step(phase, picks.integers(4, size=shape), picks.integers(1, 7, size=shape))


def beside(world, cells):
    """Starts so many cells west of each destination."""
    return (world.destinations - np.array(cells))[None]


def test_by_default_nothing_is_told():
    world = world_of({"robots": 2}, worlds=3)
    assert world.observer.broadcast_size == 0
    assert world.broadcast().shape == (3, 2, 0)
    assert world.local_observations().shape == (3, 2, 5)


def test_what_two_robots_are_told_by_hand():
    world = world_of({"robots": 2, "state": {"others": 1}})
    world.reset(beside(world, [20, 8]))
    assert world.travel_slots.tolist() == [[20, 8]]
    local = world.local_observations()[0]
    assert local.shape == (2, 13)
    assert world.broadcast()[0].tobytes() == local[:, 5:].tobytes()
    # Robot 1 will have driven 12 slots less than robot 0, of 40; 40 / 20 and 40 / 8 up to 4.
    first = [1.0, -0.3, *local[1, :5], 2.0]
    second = [1.0, 0.3, *local[0, :5], 4.0]
    assert local[0, 5:] == pytest.approx(first)
    assert local[1, 5:] == pytest.approx(second)


def test_those_with_the_fewest_slots_come_first_and_equals_by_their_index():
    world = world_of({"robots": 4, "state": {"others": 2, "destination": "none"}})
    world.reset(beside(world, [9, 5, 9, 1]))
    told = world.broadcast()[0]
    assert told.shape == (4, 11)
    places = world.local_observations()[0, :, :3]

    def who(row):
        return [
            int(np.flatnonzero((places == told[row, at + 2 : at + 5]).all(axis=-1))[0])
            for at in (0, 5)
        ]

    assert [who(k) for k in range(4)] == [[3, 1], [3, 0], [3, 1], [1, 0]]
    # Robot 3 arrives: with the fewest slots, it is still behind those that drive.
    east = np.full((1, 4), 2)
    assert world.step(np.array([0]), east, np.array([[1, 2, 3, 4]])).arrived[0, 3]
    told, places = world.broadcast()[0], world.local_observations()[0, :, :3]
    assert [who(k) for k in range(4)] == [[1, 2], [0, 2], [1, 0], [1, 0]]


def test_of_a_robot_that_has_arrived_zeros_are_told():
    world = world_of({"robots": 3, "state": {"others": 2}})
    world.reset(beside(world, [9, 1, 5]))
    world.step(np.array([0]), np.full((1, 3), 2), np.array([[1, 2, 3]]))
    assert world.driving.tolist() == [[True, False, True]]
    told = world.broadcast()[0]
    assert told[0, 0] == 1.0
    assert told[0, 7:14].tolist() == [0.0] * 7
    assert not np.signbit(told[0, 7:14]).any()
    assert told[0, 14] == 4.0


def test_a_robot_that_strays_is_told_of_as_a_later_one():
    world = world_of({"robots": 2, "state": {"others": 1}})
    world.reset(beside(world, [20, 8]))
    for _ in range(30):  # robot 0 drives west and robot 1 stays on its way
        world.step(np.array([0]), np.array([[3, 2]]), np.array([[1, 2]]))
        told = world.broadcast()[0, :, 1]
        slots = world.travel_slots[0]
        if world.driving.all():
            expected = np.clip((slots[1] - slots[0]) / 40, -2, 2)
            assert told == pytest.approx([expected, -expected], abs=1e-6)


OPTIONS = [
    {"destination": destination, "way": way, "others": others}
    for destination, way, others in product(("offset", "none"), ("on", "off"), (0, 1, 3))
]


@pytest.mark.parametrize("fading", ["static", "slot"])
@pytest.mark.parametrize("state", OPTIONS, ids=str)
def test_robots_make_the_worlds_states_and_rewards_bit_by_bit(state, fading):
    """All at once, in several worlds, and each by itself: rows are the robots', world by world."""
    reward = {"credit": "difference", "guidance_discount": 0.8}
    changes = {"robots": 4, "state": state, "reward": reward, "channel": {"fading": fading}}
    worlds, robots = 3, 4
    world, picks = world_of(changes, worlds=worlds), np.random.default_rng(0)
    start = world.cell.copy()
    start[:, 0] = world.destinations[0] - 1  # some arrive
    world.reset(start)
    everybody = LocalEnv(world.scenario.of(range(robots)), worlds)
    single = [LocalEnv(world.scenario.of([k])) for k in range(robots)]
    assert everybody.observation_size == world.observer.local_size
    assert everybody.broadcast_size == world.observer.broadcast_size

    def rows(array):
        swapped = np.ascontiguousarray(np.swapaxes(array, 0, 1))
        return swapped.reshape(worlds * robots, *array.shape[2:])

    for _ in range(12):
        left, measured, told = world.cell.copy(), world.measured_db, world.broadcast()
        seen = world.local_observations()
        made = everybody.observe(rows(left), rows(measured), rows(told))
        assert made.dtype == np.float32
        assert made.tobytes() == rows(seen).tobytes()
        for b in range(worlds):
            for k in range(robots):
                at = b, slice(k, k + 1)
                alone = single[k].observe(left[at], measured[at], told[at])
                assert alone.tobytes() == seen[at].tobytes()
        outcome = play(world, picks)
        paid = everybody.reward(
            rows(outcome.credit), rows(left), rows(world.cell), rows(outcome.arrived)
        )
        drove = rows(outcome.drove)
        assert paid[drove].tobytes() == rows(outcome.local_reward)[drove].tobytes()
    assert not world.driving.all()


def test_a_robot_that_is_told_nothing_says_so():
    world = world_of({"robots": 2, "state": {"others": 1}})
    robots = LocalEnv(world.scenario)
    with pytest.raises(ValueError, match="need what the access point tells them"):
        robots.observe(world.cell[0], world.measured_db[0])


@given(st.integers(0, 10_000), st.integers(2, 6), st.data())
@settings(max_examples=20, deadline=None)
def test_each_robot_is_told_of_as_many_others_as_drive(seed, robots, data):
    others = data.draw(st.integers(1, robots - 1))
    world = world_of({"robots": robots, "state": {"others": others}}, seed, worlds=2)
    world.driving[:] = np.random.default_rng(seed).random(world.driving.shape) < 0.7
    told = world.broadcast()
    assert told.shape == (2, robots, world.observer.broadcast_size)
    assert np.isfinite(told).all()
    flags = told[..., :-1].reshape(2, robots, others, 7)[..., 0]
    driving = world.driving.sum(axis=-1, keepdims=True) - world.driving
    assert (flags.sum(axis=-1) == np.minimum(driving, others)).all()
    assert (np.diff(flags, axis=-1) <= 0).all()  # the driving ones first
    leads = told[..., :-1].reshape(2, robots, others, 7)[..., 1]
    both = (flags[..., 1:] == 1.0) & (flags[..., :-1] == 1.0)
    assert (np.diff(leads, axis=-1)[both] >= 0).all()


def test_worlds_told_together_equal_worlds_told_alone_bit_by_bit():
    changes = {"robots": 5, "state": {"others": 3, "way": "on"}}
    together, alone = world_of(changes, worlds=6), world_of(changes)
    for _ in range(3):
        play(together, np.random.default_rng(1))
    for b in range(6):
        alone.restore({name: part[b : b + 1] for name, part in together.state().items()})
        assert alone.local_observations()[0].tobytes() == together.local_observations()[b].tobytes()


def test_a_robot_that_is_alone_is_told_of_nobody():
    view = SingleRobotEnv({"robots": 3, "state": {"others": 2}}, others="none")
    assert view.reset(seed=0)[0].shape == (5,)
    assert SingleRobotEnv({"robots": 3, "state": {"others": 2}}).reset(seed=0)[0].shape == (20,)
