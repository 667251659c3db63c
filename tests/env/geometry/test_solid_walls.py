"""Solid walls: which moves they stop, ways round them, and what may lie behind them."""

import dataclasses
from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env.apis.parallel_env import RISFleetParallelEnv
from env.checks import checked_config
from env.geometry import distances
from env.geometry.floor import STEPS, UNREACHABLE, Floor
from env.local_env import LocalEnv
from env.oracles import per_slot
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World

lattice = st.integers(0, 16).map(lambda n: n / 4)
segments = st.tuples(lattice, lattice, lattice, lattice).filter(lambda s: s[:2] != s[2:])
plans = st.lists(segments, min_size=1, max_size=6)
ROOM = {"width_m": 4.0, "depth_m": 4.0}
SMALL = {
    "robots": 2,
    "room": ROOM,
    "ap": {"position_m": [0.0, 4.0, 2.0]},
    "ris": {"position_m": [4.0, 2.0, 2.0], "side": 4},
}


def floor_of(walls, columns=8, rows=8):
    return Floor(columns, rows, 0.5, np.array(walls, dtype=float).reshape(-1, 4), solid=True)


def breadth_first(moves, start):
    slots, queue = {int(start): 0}, deque([int(start)])
    while queue:
        cell = queue.popleft()
        for following in moves[cell].tolist():
            if following not in slots:
                slots[following] = slots[cell] + 1
                queue.append(following)
    return slots


def solid(segments_m, destinations_m, **changes):
    """A room of 8 x 8 cells with solid walls."""
    tasks = {"destinations_m": destinations_m, "destination_spacing_m": 0.5, "start_distance_m": 0}
    tasks |= changes.pop("tasks", {})
    walls = {"segments": segments_m, "block_motion": True}
    return {**SMALL, "walls": walls, "tasks": tasks, **changes}


def world_of(config, seed=0, worlds=1):
    return World(Scenario.drawn(config, seed), stream(seed, Stream.WORLD), worlds)


CUP = [[1.0, 1.0, 3.0, 1.0], [3.0, 1.0, 3.0, 3.0], [3.0, 3.0, 1.0, 3.0]]  # open to the west
BOX = [*CUP, [1.0, 3.0, 1.0, 1.0]]


@given(plans)
def test_a_move_is_stopped_where_shapely_says_that_it_touches_a_wall(walls):
    shapely = pytest.importorskip("shapely")
    floor, lines = floor_of(walls), [shapely.LineString([w[:2], w[2:]]) for w in walls]
    open_moves = Floor(8, 8, 0.5, floor.walls).neighbours()
    centres, expected = floor.centres(), open_moves.copy()
    for cell in range(floor.cells):
        for direction, following in enumerate(open_moves[cell]):
            if following != cell:
                move = shapely.LineString([centres[cell], centres[following]])
                if any(move.intersects(line) for line in lines):
                    expected[cell, direction] = cell
    assert (floor.neighbours() == expected).all()


@given(plans, st.sampled_from([0.1, 0.3, 0.7]))
@settings(max_examples=40)
def test_a_wall_stops_both_ways(walls, cell_m):
    floor = dataclasses.replace(floor_of(walls), cell_m=cell_m)
    moves = floor.neighbours()
    for there, back in ((0, 1), (2, 3)):
        cells = np.flatnonzero(moves[:, there] != np.arange(floor.cells))
        assert (moves[moves[cells, there], back] == cells).all()


def test_walls_that_are_not_solid_stop_nobody():
    moves = Floor(8, 8, 0.5, np.array(BOX)).neighbours()
    assert (moves == Floor(8, 8, 0.5, np.empty((0, 4))).neighbours()).all()


@given(plans, st.lists(st.integers(0, 63), min_size=1, max_size=3))
def test_ways_are_those_of_a_breadth_first_search(walls, destinations):
    floor = floor_of(walls)
    found = floor.slots_to(np.array(destinations))
    for column, destination in zip(found.T, destinations, strict=True):
        slots = breadth_first(floor.neighbours(), destination)
        assert column.tolist() == [slots.get(cell, UNREACHABLE) for cell in range(floor.cells)]


@given(plans)
def test_the_drivable_floor_is_the_largest_part(walls):
    floor = floor_of(walls)
    moves, left, parts = floor.neighbours(), set(range(floor.cells)), []
    while left:
        parts.append({*breadth_first(moves, min(left))})
        left -= parts[-1]
    largest = min(parts, key=lambda part: (-len(part), min(part)))
    assert {*np.flatnonzero(floor.drivable()).tolist()} == largest


@pytest.mark.slow
def test_ways_over_250000_cells_with_walls():
    wall = [[0.0, 125.0, 249.0, 125.0]]
    floor = floor_of(wall, 500, 500)
    slots = floor.slots_to(np.array([0]))[:, 0]
    assert slots[-1] == 998
    assert slots[250 * 500] == 2 * 498 + 250
    assert floor.drivable().all()


@given(plans, st.integers(0, 63), st.integers(0, 63))
def test_shortest_directions_take_a_robot_round_walls_in_as_many_slots_as_the_way_has(
    walls, start, goal
):
    config = checked_config(solid([list(wall) for wall in walls], [], robots=1, tasks={
        "destination": "random"
    }))  # fmt: skip
    world = World(Scenario(config, np.array([goal])), stream(0, Stream.WORLD))
    world.reset(np.array([[start]]))
    left = int(world.shortest_slots[0, 0])
    if left < UNREACHABLE:
        for slots in range(left, 0, -1):
            assert world.shortest_slots[0, 0] == slots
            world.cell = world.next_cell[world.cell, per_slot.shortest_directions(world)]
        assert world.cell == goal


def test_a_way_round_goes_away_from_the_goal_where_it_must():
    config = checked_config(solid(CUP, [[3.25, 2.25]], robots=1))
    world = world_of(config)
    world.reset(np.array([[4 * 8 + 5]]))  # inside the cup, right before its bottom
    assert tuple(STEPS[per_slot.shortest_directions(world)[0, 0]]) == (-1, 0)


def test_a_robot_stays_put_before_a_solid_wall_and_pays_for_the_slot():
    config = checked_config(solid(CUP, [[3.25, 2.25], [0.25, 0.25]]))
    world = world_of(config)
    world.reset(np.array([[4 * 8 + 5, 40]]))
    east = np.array([[2, 0]])
    outcome = world.step(np.zeros(1, dtype=int), east, np.array([[1, 2]]))
    assert world.cell.tolist() == [[4 * 8 + 5, 48]]
    assert outcome.local_reward[0, 0] == pytest.approx(0.05 * outcome.rate[0, 0] - 1.0)


# What may lie where.


def test_starts_and_drawn_destinations_are_on_the_drivable_floor():
    config = checked_config(solid(BOX, [], tasks={"destination": "random"}))
    inside = ~Floor.from_config(config).drivable()
    assert inside.sum() == 16
    for seed in range(40):
        world = world_of(config, seed, worlds=50)
        world.reset()
        assert not inside[world.destinations].any()
        assert not inside[world.cell].any()


CUT_OFF = "places that the rest of the floor can reach with env.walls.block_motion=true"


@pytest.mark.parametrize("place", [[2.25, 2.25], [1.25, 1.25]])
def test_a_place_that_is_cut_off_is_named(place):
    with pytest.raises(ValueError, match="block_motion=true") as caught:
        checked_config(solid(BOX, [[0.25, 0.25], place]))
    assert str(caught.value) == f"env.tasks.destinations_m={place!r}: allowed is {CUT_OFF}"
    tasks = {"start": "fixed", "starts_m": [[3.25, 0.25], place]}
    with pytest.raises(ValueError, match="block_motion=true") as caught:
        checked_config(solid(BOX, [[0.25, 0.25], [0.25, 1.25]], tasks=tasks))
    assert str(caught.value) == f"env.tasks.starts_m={place!r}: allowed is {CUT_OFF}"


def test_places_of_robots_that_there_are_not_may_be_cut_off():
    assert checked_config(solid(BOX, [[0.25, 0.25], [0.25, 1.25], [2.25, 2.25]])).robots == 2


@given(plans, st.floats(0, 5), st.booleans(), st.integers(0, 50))
def test_a_start_distance_is_allowed_just_where_every_robot_has_somewhere_to_start(
    walls, distance_m, drawn, seed
):
    floor = floor_of(walls)
    drivable = np.flatnonzero(floor.drivable())
    goals = [] if drawn else floor.centres()[drivable[[0, -1]]].tolist()
    if len(drivable) < 4:
        return
    tasks = {"start_distance_m": distance_m, "destination": "random" if drawn else "fixed"}
    settings_ = solid([list(wall) for wall in walls], goals, tasks=tasks)
    among = drivable if drawn else drivable[[0, -1]]
    reach = distances.straight_m(floor, among)[drivable].max(axis=0).min()
    if distance_m > reach:
        with pytest.raises(ValueError, match=r"env\.tasks\.start_distance_m"):
            checked_config(settings_)
    else:
        world = world_of(checked_config(settings_), seed, worlds=5)
        world.reset()
        assert (world.shortest_slots < UNREACHABLE).all()


def test_starts_in_a_views_options_need_a_way():
    view = RISFleetParallelEnv(solid(BOX, [[0.25, 0.25], [0.25, 1.25]]))
    with pytest.raises(ValueError, match="allowed is with a way to drive"):
        view.reset(options={"starts_m": [[3.25, 0.25], [2.25, 2.25]]})


# The way in a robot's state.


def test_a_robot_before_a_solid_wall_sees_its_way_by_hand():
    config = checked_config(solid(CUP, [[3.25, 2.25]], robots=1))
    world = world_of(config)
    world.reset(np.array([[4 * 8 + 5]]))  # inside the cup, right before its bottom
    left = int(world.shortest_slots[0, 0])
    found = world.local_observations()[0, 0]
    assert found.dtype == np.float32
    # North and south lie the cup's sides, one cell off; east is the wall, west leads out.
    saved = [left - int(world.slots_to_go[cell, 0]) for cell in world.next_cell[4 * 8 + 5]]
    assert saved[2:] == [0, 1]
    assert found[5:9].tolist() == saved
    assert found[9] == np.float32(left / 8)  # 8 rows and 8 columns
    world.reset(np.array([[4 * 8 + 7]]))  # beyond the bottom, beside the destination
    assert world.local_observations()[0, 0, 5:].tolist() == [-1.0, -1.0, 0.0, 1.0, 0.125]


def test_where_no_way_leads_the_way_is_a_long_one_and_no_move_saves():
    config = checked_config(solid(BOX, [[0.25, 0.25], [0.25, 1.25]]))
    world = world_of(config)
    inside = int(world.floor.cell_at(np.array([2.25, 2.25])))
    assert world.slots_to_go[inside, 0] == UNREACHABLE
    world.reset(np.array([[inside, inside]]))
    assert world.local_observations()[0, :, 5:].tolist() == [[0.0, 0.0, 0.0, 0.0, 10.0]] * 2


def test_the_way_is_seen_by_default_where_walls_are_solid_and_by_robots_alone():
    goals = [[3.25, 2.25], [0.25, 0.25]]
    sizes = {}
    for block in (False, True):
        for way in ("auto", "on", "off"):
            changes = {"state": {"way": way}, "tasks": {"start_distance_m": 0.5}}
            settings_ = solid(CUP, goals, **changes)
            settings_["walls"] = {**settings_["walls"], "block_motion": block}
            world = world_of(checked_config(settings_))
            world.reset()
            sizes[block, way] = world.local_observations().shape[-1]
            assert world.observer.local_size == sizes[block, way]
            assert world.global_observation().shape == (1, 16)
    assert sizes == {
        (False, "auto"): 5, (False, "on"): 10, (False, "off"): 5,
        (True, "auto"): 10, (True, "on"): 10, (True, "off"): 5,
    }  # fmt: skip


@given(plans, st.integers(0, 50))
def test_a_move_that_saves_a_slot_is_there_until_the_destination(walls, seed):
    """Following any move with a 1 takes the shortest way, whatever stands between."""
    floor = floor_of(walls)
    drivable = np.flatnonzero(floor.drivable())
    if len(drivable) < 4:
        return
    goals = floor.centres()[drivable[[0, -1]]].tolist()
    changes = {"tasks": {"start_distance_m": 0.0}}
    world = world_of(checked_config(solid([list(wall) for wall in walls], goals, **changes)), seed)
    world.reset()
    shortest = world.shortest_slots[0].copy()
    for slot in range(1, int(shortest.max()) + 1):
        saved = world.local_observations()[..., 5:9]
        assert set(np.unique(saved)) <= {-1.0, 0.0, 1.0}
        world.step(np.zeros(1, dtype=int), saved.argmax(axis=-1), np.array([[1, 2]]))
        assert world.driving[0].tolist() == (shortest > slot).tolist()


# Guidance.


def test_guidance_along_the_way_is_the_length_over_the_floor_in_metres():
    config = checked_config(solid(CUP, [[3.25, 2.25]], robots=1, reward={"distance": "way"}))
    world = world_of(config)
    world.reset(np.array([[4 * 8 + 5]]))
    before = world.shortest_slots[0, 0]
    assert before > 9  # straight, it is one cell
    outcome = world.step(np.zeros(1, dtype=int), np.array([[3]]), np.array([[1]]))
    gained = 3.0 * 0.5 - 1.0 + 0.05 * outcome.rate[0, 0]
    assert outcome.local_reward[0, 0] == pytest.approx(gained)
    straight = checked_config(solid(CUP, [[3.25, 2.25]], robots=1, reward={"distance": "straight"}))
    other = world_of(straight)
    other.reset(np.array([[4 * 8 + 5]]))
    outcome = other.step(np.zeros(1, dtype=int), np.array([[3]]), np.array([[1]]))
    assert outcome.local_reward[0, 0] == pytest.approx(gained - 2 * 3.0 * 0.5)


@pytest.mark.parametrize("block", [False, True])
@pytest.mark.parametrize("along", ["auto", "straight", "way"])
def test_a_slice_makes_the_worlds_reward_bit_by_bit(block, along):
    changes = {"reward": {"distance": along}, "collisions": "block" if block else "allow"}
    config = checked_config(solid(CUP, [[3.25, 2.25], [0.25, 0.25]], **changes))
    world, generator = world_of(config), np.random.default_rng(0)
    world.reset()
    whole = LocalEnv(Scenario(config, world.destinations))
    single = [LocalEnv(Scenario(config, world.destinations[k : k + 1])) for k in range(2)]
    for _ in range(80):
        left = world.cell[0].astype(np.int32)
        direction, level = generator.integers(4, size=(1, 2)), generator.integers(1, 7, size=(1, 2))
        outcome = world.step(np.zeros(1, dtype=int), direction, level)
        told = (outcome.rate[0], left, world.cell[0].astype(np.int32), outcome.arrived[0])
        made, drove = whole.reward(*told), outcome.drove[0]
        assert made[drove].tobytes() == outcome.local_reward[0, drove].tobytes()
        for k in np.flatnonzero(drove):
            alone = single[k].reward(*(part[k : k + 1] for part in told))
            assert alone[0] == outcome.local_reward[0, k]


@pytest.mark.parametrize("name", ["corridor", "hall"])
def test_by_default_the_way_guides_where_walls_are_solid_and_nowhere_else(name):
    def table(plan, **changes):
        config = checked_config({"plan": plan, **changes})
        return world_of(config).scenario.distance_m

    way, straight = ({"reward": {"distance": along}} for along in ("way", "straight"))
    assert (table(name) == table(name, **way)).all()
    assert (table("default") == table("default", **straight)).all()
    radio = {"walls": {"block_motion": False}}
    assert (table(name, **radio) == table(name, **radio, **straight)).all()


def test_the_start_distance_stays_a_straight_one():
    changes = {"tasks": {"start_distance_m": 2.0}}
    goals = [[3.25, 2.25], [0.25, 0.25]]
    straight = world_of(
        checked_config(solid(CUP, goals, reward={"distance": "straight"}, **changes)), worlds=20
    )
    way = world_of(
        checked_config(solid(CUP, goals, reward={"distance": "way"}, **changes)), worlds=20
    )
    assert (straight.draw_starts(20) == way.draw_starts(20)).all()
