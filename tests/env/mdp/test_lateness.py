"""Starts from which no robot can arrive: their share, and where there are no others."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env.apis.parallel_env import RISFleetParallelEnv
from env.apis.single_robot import SingleRobotEnv
from env.checks import checked_config
from env.config import EnvConfig
from env.config_checks import problems
from env.geometry import floor_plans
from env.geometry.floor import Floor
from env.mdp import lateness
from env.mdp.destinations import draw_destinations
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World

lattice = st.integers(0, 16).map(lambda n: n / 4)
segments = st.tuples(lattice, lattice, lattice, lattice).filter(lambda s: s[:2] != s[2:])
CUP = [[1.0, 1.0, 3.0, 1.0], [3.0, 1.0, 3.0, 3.0], [3.0, 3.0, 1.0, 3.0]]  # open to the west


def small(walls=(), robots=1, max_slots=10, **tasks):
    """A room of 8 x 8 cells, its walls solid."""
    tasks = {"destinations_m": [[3.25, 2.25], [0.25, 0.25]], "start_distance_m": 0.0} | tasks
    return {
        "robots": robots,
        "room": {"width_m": 4.0, "depth_m": 4.0},
        "ap": {"position_m": [0.0, 4.0, 2.0]},
        "ris": {"position_m": [4.0, 2.0, 2.0], "side": 4},
        "walls": {"segments": [list(wall) for wall in walls], "block_motion": True},
        "motion": {"max_slots": max_slots},
        "tasks": tasks,
    }


def whole(settings_):
    """A configuration from nested fields that is not checked."""
    config = EnvConfig()
    for name, value in settings_.items():
        inner = getattr(config, name)
        new = dataclasses.replace(inner, **value) if isinstance(value, dict) else value
        config = dataclasses.replace(config, **{name: new})
    return config


def goals_of(config, seed=0):
    return draw_destinations(config, stream(seed, Stream.DESTINATIONS))


def arrives(config, goals, robot, start):
    """Whether some moves take a robot to its destination in time: all cells that it can be in."""
    moves, at = Floor.from_config(config).neighbours(), np.array([start])
    for _ in range(config.motion.max_slots):
        at = np.unique(moves[at])
        if goals[robot] in at:
            return True
    return False


@settings(max_examples=25)
@given(st.lists(segments, max_size=6), st.integers(1, 14), st.floats(0, 4), st.integers(0, 20))
def test_the_share_is_that_of_starts_from_which_no_moves_arrive(walls, slots, apart_m, seed):
    drawn = {"destination": "random", "destination_spacing_m": 0.5, "start_distance_m": apart_m}
    config = whole(small(walls, 2, 1000, **drawn))
    if problems(config):
        return
    goals = goals_of(config, seed)
    config = dataclasses.replace(config, motion=dataclasses.replace(config.motion, max_slots=slots))
    scenario = Scenario(config, goals)
    late = [
        [not arrives(config, goals, robot, start) for start in scenario.start_cells[robot]]
        for robot in range(2)
    ]
    shares = lateness.late_shares(config, goals)
    assert shares.tolist() == [np.mean(one) for one in late]
    assert lateness.late_share(config, goals) == pytest.approx(np.mean([np.mean(o) for o in late]))
    assert bool(lateness.problems(config, goals)) == any(all(one) for one in late)


@given(st.lists(segments, max_size=6), st.integers(1, 9), st.floats(0, 4))
def test_the_number_of_slots_that_a_refusal_names_is_the_least_that_is_allowed(
    walls, slots, apart_m
):
    config = whole(small(walls, 2, slots, start_distance_m=apart_m))
    found = problems(config)
    if [key for key, _, _ in found] != [lateness.KEY]:
        return
    assert found[0][1] == slots
    least = int(found[0][2].split()[2].rstrip(","))
    for most, wrong in ((least, []), (least - 1, [lateness.KEY])):
        changed = dataclasses.replace(config.motion, max_slots=most)
        config = dataclasses.replace(config, motion=changed)
        assert [key for key, _, _ in problems(config)] == wrong


def test_ten_slots_are_refused_where_all_starts_are_ten_metres_away():
    with pytest.raises(ValueError, match=r"max_slots=10") as caught:
        checked_config({"motion": {"max_slots": 10}})
    assert str(caught.value) == (
        "env.motion.max_slots=10: allowed is at least 20, since robot_0 has no nearer start with"
        " env.tasks.start_distance_m=10"
    )
    near = {"motion": {"max_slots": 10}, "tasks": {"start_distance_m": 5.0}}
    assert checked_config(near).motion.max_slots == 10


def test_a_fixed_start_must_be_near_enough():
    fixed = {"start": "fixed", "starts_m": [[3.25, 0.25], [0.25, 3.75]]}
    assert checked_config(small(robots=2, max_slots=7, **fixed)).robots == 2
    with pytest.raises(ValueError, match="max_slots=6") as caught:
        checked_config(small(robots=2, max_slots=6, **fixed))
    assert str(caught.value) == (
        "env.motion.max_slots=6: allowed is at least 7, since robot_1 starts that many slots from"
        " its destination"
    )
    inside = {"start": "fixed", "starts_m": [[2.75, 2.25]]}  # a cell away, behind the cup's bottom
    checked_config(small(CUP, max_slots=13, **inside))
    with pytest.raises(ValueError, match="allowed is at least 13, since robot_0 starts"):
        checked_config(small(CUP, max_slots=12, **inside))


def test_a_robot_that_starts_on_its_destination_drives_off_and_back():
    middle = {"destinations_m": [[2.25, 2.25]], "start_distance_m": 0.0}
    corner = {"destinations_m": [[0.25, 0.25]], "start_distance_m": 0.0}
    for tasks, late in ((middle, 60 / 64), (corner, 61 / 64)):  # neighbours, and the corner itself
        config = checked_config(small(max_slots=1, **tasks))
        assert lateness.late_share(config, goals_of(config)) == pytest.approx(late)


@pytest.mark.parametrize("view", [RISFleetParallelEnv, SingleRobotEnv])
@pytest.mark.parametrize("destination", ["fixed", "random", "common"])
def test_the_views_refuse_it_wherever_destinations_come_from(view, destination):
    config = {"robots": 2, "motion": {"max_slots": 10}, "tasks": {"destination": destination}}
    with pytest.raises(ValueError, match=r"^env\.motion\.max_slots=10: allowed is at least \d+, "):
        view(config, seed=3)


def test_destinations_of_a_seed_decide_where_they_are_drawn():
    """Far starts of a destination in a corner are out of reach, those of one in the middle not."""
    drawn = {"destination": "random", "start_distance_m": 2.4}
    config = checked_config(small(max_slots=5, **drawn))
    late = [bool(lateness.problems(config, goals_of(config, seed))) for seed in range(12)]
    assert {*late} == {True, False}
    for seed, refused in enumerate(late):
        if refused:
            with pytest.raises(ValueError, match=r"max_slots=5: allowed is at least \d, since"):
                RISFleetParallelEnv(config, seed=seed)
        else:
            RISFleetParallelEnv(config, seed=seed).reset()


@pytest.mark.parametrize("plan", floor_plans.built_in())
@pytest.mark.parametrize("collisions", ["allow", "block"])
def test_from_every_start_of_a_built_in_plan_robots_can_arrive(plan, collisions):
    config = checked_config({"plan": plan, "robots": 4, "collisions": collisions})
    assert lateness.late_share(config, goals_of(config)) == 0.0


def test_half_of_the_starts_of_a_hall_of_100_m_are_too_far():
    config = checked_config({"room": {"width_m": 100.0, "depth_m": 100.0}})
    shares = lateness.late_shares(config, goals_of(config))
    assert shares.round(2).tolist() == [0.45, 0.62, 0.56]
    world = World(Scenario(config, goals_of(config)), stream(0, Stream.WORLD), worlds=4000)
    world.reset()
    assert (world.shortest_slots > 150).mean() == pytest.approx(shares.mean(), abs=0.02)
