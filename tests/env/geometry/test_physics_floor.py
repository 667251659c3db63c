"""The floor plan: cells, neighbours, lines of sight, lengths and destinations."""

import dataclasses
from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env.config import EnvConfig, RoomConfig, TasksConfig
from env.geometry.floor import DIRECTIONS, Floor, line_of_sight
from env.mdp.destinations import draw_destinations
from env.seeding import Stream, stream

NO_WALLS = np.empty((0, 4))
small = st.integers(2, 12)
lattice = st.integers(0, 6).map(float)
segment = st.tuples(lattice, lattice, lattice, lattice).filter(lambda s: s[:2] != s[2:])


def floor_of(columns, rows, cell_m=0.5):
    return Floor(columns, rows, cell_m, NO_WALLS)


def breadth_first_slots(floor, start):
    """Slots from one cell to every other along the moves that robots have."""
    moves = floor.neighbours()
    slots = {start: 0}
    queue = deque([start])
    while queue:
        cell = queue.popleft()
        for following in moves[cell]:
            if following not in slots:
                slots[int(following)] = slots[cell] + 1
                queue.append(int(following))
    return [slots[cell] for cell in range(floor.cells)]


def test_the_default_room_has_60_by_60_cells_and_robots_stand_at_their_centres():
    floor = Floor.from_config(EnvConfig())
    assert (floor.columns, floor.rows, floor.cells) == (60, 60, 3600)
    assert floor.centres()[0].tolist() == [0.25, 0.25]
    assert floor.centres()[61].tolist() == [0.75, 0.75]
    assert floor.centres()[-1].tolist() == [29.75, 29.75]
    assert floor.size_m.tolist() == [30.0, 30.0]


@given(small, small, st.sampled_from([0.1, 0.25, 0.5, 1.0, 3.0]))
def test_every_centre_lies_in_its_own_cell(columns, rows, cell_m):
    floor = floor_of(columns, rows, cell_m)
    assert floor.cell_at(floor.centres()).tolist() == list(range(floor.cells))


def test_a_cell_holds_its_lower_left_edge():
    floor = floor_of(4, 3)
    assert floor.cell_at(np.array([[0.0, 0.0], [0.5, 0.0], [0.49, 0.5]])).tolist() == [0, 1, 4]


@pytest.mark.parametrize("position", [(-0.01, 1.0), (1.0, -0.01), (2.0, 1.0), (1.0, 1.5)])
def test_a_position_outside_the_room_is_refused(position):
    with pytest.raises(ValueError, match="outside the room"):
        floor_of(4, 3).cell_at(np.array(position))


def test_moves_lead_to_the_cell_on_that_side():
    moves = floor_of(4, 3).neighbours()[5]
    assert dict(zip(DIRECTIONS, moves.tolist(), strict=True)) == {"n": 9, "s": 1, "e": 6, "w": 4}


@given(small, small)
@settings(max_examples=30)
def test_a_move_changes_one_coordinate_by_one_cell_or_stays_at_the_edge(columns, rows):
    floor = floor_of(columns, rows)
    centres = floor.centres()
    steps = np.array([(0.0, 0.5), (0.0, -0.5), (0.5, 0.0), (-0.5, 0.0)])
    for direction in range(4):
        there = centres + steps[direction]
        inside = ((there > 0) & (there < floor.size_m)).all(axis=-1)
        expected = np.where(inside[:, None], there, centres)
        assert (centres[floor.neighbours()[:, direction]] == expected).all()


@given(small, small, st.data())
@settings(max_examples=30)
def test_shortest_slots_are_those_of_a_breadth_first_search(columns, rows, data):
    floor = floor_of(columns, rows)
    start = data.draw(st.integers(0, floor.cells - 1))
    slots = floor.shortest_slots(np.array(start), np.arange(floor.cells))
    assert slots.tolist() == breadth_first_slots(floor, start)


def test_the_longest_way_through_the_default_room_is_118_slots():
    floor = Floor.from_config(EnvConfig())
    assert int(floor.shortest_slots(np.array(0), np.array(floor.cells - 1))) == 118


@pytest.mark.parametrize("seed", range(8))
def test_line_of_sight_is_that_of_shapely_for_random_walls(seed):
    shapely = pytest.importorskip("shapely")
    generator = np.random.default_rng(seed)
    walls = generator.uniform(0, 30, size=(seed + 1, 4))
    end, points = generator.uniform(0, 30, size=2), generator.uniform(0, 30, size=(150, 2))
    lines = [shapely.LineString([w[:2], w[2:]]) for w in walls]
    links = [shapely.LineString([end, point]) for point in points]
    expected = [not any(link.intersects(line) for line in lines) for link in links]
    assert line_of_sight(end, points, walls).tolist() == expected
    assert 0 < sum(expected) < 150


@given(st.tuples(lattice, lattice), st.tuples(lattice, lattice), st.lists(segment, max_size=4))
def test_a_link_that_touches_a_wall_or_runs_along_it_is_blocked(end, point, walls):
    shapely = pytest.importorskip("shapely")
    link = shapely.Point(end) if end == point else shapely.LineString([end, point])
    blocked = any(link.intersects(shapely.LineString([w[:2], w[2:]])) for w in walls)
    found = line_of_sight(np.array(end), np.array([point]), np.array(walls).reshape(-1, 4))
    assert found.tolist() == [not blocked]


def test_the_default_wall_shades_what_lies_behind_it_and_not_the_surface():
    config = EnvConfig()
    walls = Floor.from_config(config).walls
    ap = np.asarray(config.ap.position_m)
    # From (15, 30) to (29.75, 0.25) a link passes y = 15 at x = 22.4, past the wall's end at 21.
    points = np.array([[15.25, 14.75], [0.25, 0.25], [29.75, 0.25], [15.25, 15.25]])
    assert line_of_sight(ap, points, walls).tolist() == [False, False, True, True]
    ris = np.asarray(config.ris.position_m)[None, :2]
    assert line_of_sight(ap, ris, walls).tolist() == [True]


def test_destinations_of_the_configuration_come_first_and_draw_nothing():
    config = dataclasses.replace(EnvConfig(), robots=4)
    generator = stream(0, Stream.DESTINATIONS)
    centres = Floor.from_config(config).centres()
    chosen = draw_destinations(config, generator)
    expected = [[27.25, 12.25], [4.25, 10.25], [22.25, 2.25], [26.25, 24.25]]
    assert centres[chosen].tolist() == expected
    assert generator.random() == stream(0, Stream.DESTINATIONS).random()


@given(st.integers(0, 10_000), st.integers(5, 12), st.sampled_from([0.5, 2.0, 5.0]))
@settings(max_examples=15)
def test_drawn_destinations_keep_their_distance(seed, robots, spacing_m):
    tasks = TasksConfig(destination_spacing_m=spacing_m)
    config = EnvConfig(robots=robots, tasks=tasks)
    cells = draw_destinations(config, stream(seed, Stream.DESTINATIONS))
    at = Floor.from_config(config).centres()[cells]
    apart = np.linalg.norm(at[:, None] - at, axis=-1)
    assert apart[np.triu_indices(robots, 1)].min() >= spacing_m
    again = draw_destinations(config, stream(seed, Stream.DESTINATIONS))
    assert again.tolist() == cells.tolist()


def test_destinations_differ_between_seeds_where_they_are_drawn():
    config = EnvConfig(robots=5)
    drawn = {int(draw_destinations(config, stream(s, Stream.DESTINATIONS))[4]) for s in range(10)}
    assert len(drawn) > 5


@given(st.integers(0, 10_000), st.integers(2, 6))
@settings(max_examples=15)
def test_random_destinations_are_all_drawn_and_keep_their_distance(seed, robots):
    config = EnvConfig(robots=robots, tasks=TasksConfig(destination="random"))
    cells = draw_destinations(config, stream(seed, Stream.DESTINATIONS))
    at = Floor.from_config(config).centres()[cells]
    apart = np.linalg.norm(at[:, None] - at, axis=-1)
    assert apart[np.triu_indices(robots, 1)].min() >= 5.0
    again = draw_destinations(config, stream(seed, Stream.DESTINATIONS))
    assert again.tolist() == cells.tolist()


def test_random_destinations_differ_between_seeds():
    config = EnvConfig(robots=2, tasks=TasksConfig(destination="random"))
    drawn = {int(draw_destinations(config, stream(s, Stream.DESTINATIONS))[0]) for s in range(10)}
    assert len(drawn) > 8


@pytest.mark.parametrize("given_m", [[[27.25, 12.25], [4.25, 10.25]], []])
def test_a_common_destination_is_the_first_one_given_or_drawn(given_m):
    tasks = TasksConfig(destination="common", destinations_m=given_m)
    config = EnvConfig(robots=5, tasks=tasks)
    cells = draw_destinations(config, stream(0, Stream.DESTINATIONS))
    assert len({*cells.tolist()}) == 1
    assert cells.shape == (5,)
    if given_m:
        assert Floor.from_config(config).centres()[cells[0]].tolist() == given_m[0]


def test_no_destination_is_drawn_where_a_robot_always_starts():
    room = RoomConfig(width_m=1.0, depth_m=1.0)
    tasks = TasksConfig(
        destination="common",
        destinations_m=[],
        start="fixed",
        starts_m=[[0.25, 0.25], [0.25, 0.75], [0.75, 0.25]],
    )
    config = EnvConfig(robots=3, room=room, tasks=tasks)
    cells = [draw_destinations(config, stream(s, Stream.DESTINATIONS))[0] for s in range(8)]
    assert cells == [3] * 8


def test_too_many_destinations_for_the_floor_are_refused():
    config = EnvConfig(
        robots=3,
        room=RoomConfig(width_m=4.0, depth_m=4.0),
        tasks=TasksConfig(destinations_m=[[0.25, 0.25]], destination_spacing_m=4.0),
    )
    with pytest.raises(ValueError, match="no room for 3 destinations"):
        draw_destinations(config, stream(0, Stream.DESTINATIONS))
