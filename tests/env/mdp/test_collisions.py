"""Robots that do not share cells: moves in the order of indices, and starts of their own."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from env.apis.parallel_env import RISFleetParallelEnv
from env.checks import checked_config
from env.config_checks import problems
from env.mdp.collisions import moves_without_collisions
from env.mdp.destinations import draw_destinations
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World

NORTH, SOUTH, EAST, WEST = range(4)
TASKS = {
    "destinations_m": [[2.75, 0.25], [0.25, 0.25], [2.75, 2.75]],
    "destination_spacing_m": 0.0,
    "start_distance_m": 0.0,
}
BLOCK = {
    "collisions": "block",
    "room": {"width_m": 3.0, "depth_m": 3.0},
    "walls": {"segments": []},
    "ap": {"position_m": [1.5, 3.0, 2.0]},
    "ris": {"position_m": [3.0, 1.5, 2.0], "side": 4},
    "tasks": TASKS,
}


def literal(cell, wanted, driving, destinations):
    """One world at a time, one robot at a time, by the rule's words."""
    after = []
    for places, moves, drives in zip(cell, wanted, driving, strict=True):
        on_floor = {k: place for k, place in enumerate(places) if drives[k]}
        at = list(places)
        for k in list(on_floor):
            others = [place for j, place in on_floor.items() if j != k]
            if moves[k] not in others:
                at[k] = on_floor[k] = moves[k]
            if at[k] == destinations[k]:
                del on_floor[k]
        after.append(at)
    return after


@st.composite
def scenes(draw):
    """Robots on a few cells, the driving ones apart, with any moves to cells near by."""
    robots, worlds = draw(st.integers(1, 5)), draw(st.integers(1, 4))
    cells = st.permutations(range(8)).map(lambda order: order[:robots])
    cell = [draw(cells) for _ in range(worlds)]
    grid = st.lists(st.integers(0, 7), min_size=robots, max_size=robots)
    wanted = [draw(grid) for _ in range(worlds)]
    flags = st.lists(st.booleans(), min_size=robots, max_size=robots)
    driving = [draw(flags) for _ in range(worlds)]
    return tuple(map(np.array, (cell, wanted, driving, draw(grid))))


@given(scenes())
def test_moves_are_those_of_the_rule_word_by_word(scene):
    assert moves_without_collisions(*scene).tolist() == literal(*(part.tolist() for part in scene))


@given(scenes())
def test_driving_robots_never_share_a_cell_and_never_swap(scene):
    cell, _, driving, destinations = scene
    after = moves_without_collisions(*scene)
    still = driving & (after != destinations)
    for b in range(len(cell)):
        held = after[b, still[b]].tolist()
        assert len(held) == len({*held})
        for i, j in zip(*np.nonzero(np.triu(np.outer(still[b], still[b]), 1)), strict=True):
            assert not (after[b, i] == cell[b, j] and after[b, j] == cell[b, i])
    assert (after[~driving] == cell[~driving]).all()


def blocked_world(starts, destinations=(5, 0), **changes):
    config = checked_config({**BLOCK, "robots": len(destinations), **changes})
    world = World(Scenario(config, np.array(destinations)), stream(0, Stream.WORLD))
    world.reset(np.array([starts]))
    return world


def step(world, *directions):
    level = np.arange(1, len(directions) + 1)[None]
    return world.step(np.zeros(1, dtype=int), np.array([directions]), level)


def test_two_robots_face_to_face_cannot_swap():
    world = blocked_world((13, 14), (5, 0))
    outcome = step(world, EAST, WEST)
    assert world.cell.tolist() == [[13, 14]]
    assert (outcome.rate > 0).all()


def test_of_two_that_want_one_cell_the_lower_index_gets_it():
    world = blocked_world((13, 15), (5, 0))
    step(world, EAST, WEST)
    assert world.cell.tolist() == [[14, 15]]


def test_a_row_moves_up_where_its_front_has_the_lowest_index():
    world = blocked_world((15, 14), (5, 0))
    step(world, EAST, EAST)
    assert world.cell.tolist() == [[16, 15]]
    behind = blocked_world((14, 15), (5, 0))
    step(behind, EAST, EAST)
    assert behind.cell.tolist() == [[14, 16]]


def test_a_robot_that_has_arrived_holds_no_cell():
    world = blocked_world((4, 14), (5, 0))
    step(world, EAST, NORTH)
    assert world.driving.tolist() == [[False, True]]
    world.cell = np.array([[5, 4]])
    step(world, EAST, EAST)
    assert world.cell.tolist() == [[5, 5]]


def test_two_robots_with_one_destination_may_arrive_in_one_slot():
    world = blocked_world((13, 15), (14, 14))
    assert step(world, EAST, WEST).arrived.tolist() == [[True, True]]


def test_by_default_robots_share_cells():
    world = blocked_world((13, 14), (5, 0), collisions="allow")
    step(world, EAST, WEST)
    assert world.cell.tolist() == [[14, 13]]


def test_worlds_of_robots_that_drive_at_random_never_hold_two_in_a_cell():
    config = checked_config({**BLOCK, "robots": 3})
    goals, generator = np.array([5, 0, 35]), np.random.default_rng(0)
    world = World(Scenario(config, goals), stream(0, Stream.WORLD), worlds=60)
    world.reset()
    for _ in range(40):
        shape = world.cell.shape
        world.step(np.zeros(60, dtype=int), generator.integers(4, size=shape), np.ones(shape, int))
        places = np.where(world.driving, world.cell, -1 - np.arange(3))
        assert all(len({*row}) == 3 for row in places.tolist())
    assert not world.driving.all()


# Starts.


def test_random_starts_are_cells_of_their_own_and_cover_all_of_them():
    config = checked_config({**BLOCK, "robots": 3})
    starts = World(Scenario.drawn(config, 0), stream(0, Stream.WORLD)).draw_starts(3000)
    assert all(len({*row}) == 3 for row in starts.tolist())
    assert all(len({*column}) == 36 for column in starts.T.tolist())


def test_starts_that_may_coincide_are_drawn_as_ever():
    config = checked_config({**BLOCK, "robots": 3, "collisions": "allow"})
    goals, generator = np.array([5, 0, 35]), stream(4, Stream.WORLD)
    starts = World(Scenario(config, goals), stream(4, Stream.WORLD)).draw_starts(50)
    expected = [generator.choice(np.arange(36), size=50) for _ in range(3)]
    assert starts.T.tolist() == np.array(expected).tolist()


def test_equal_fixed_starts_are_an_error_only_where_robots_block_each_other():
    starts = [[1.0, 1.0], [1.2, 1.2], [2.0, 2.0]]
    tasks = {**TASKS, "start": "fixed", "starts_m": starts}
    with pytest.raises(ValueError, match="places in cells of their own") as caught:
        checked_config({**BLOCK, "tasks": tasks})
    assert str(caught.value).startswith(f"env.tasks.starts_m={starts!r}: allowed is")
    assert checked_config({**BLOCK, "tasks": tasks, "collisions": "allow"}).robots == 3
    assert checked_config({**BLOCK, "robots": 1, "tasks": tasks}).robots == 1


def test_a_floor_with_fewer_cells_to_start_from_than_robots_is_refused_at_once():
    config = checked_config({**BLOCK, "tasks": {**TASKS, "start_distance_m": 3.5}})
    assert problems(config) == []
    with pytest.raises(ValueError, match="no room for 3 starts in cells of their own"):
        draw_destinations(config, stream(0, Stream.DESTINATIONS))
    shared = dataclasses.replace(config, collisions="allow")
    assert len(draw_destinations(shared, stream(0, Stream.DESTINATIONS))) == 3


def test_equal_starts_in_a_views_options_are_refused():
    view = RISFleetParallelEnv({**BLOCK, "robots": 2})
    with pytest.raises(ValueError, match="cells of their own"):
        view.reset(options={"starts_m": [[1.0, 1.0], [1.2, 1.2]]})
