"""Where the access point and the RIS hang: what walls there shade, and which ones hold a device."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from env.checks import checked_config
from env.config import EnvConfig, RisConfig, WallsConfig
from env.config_checks import problems
from env.geometry.floor import Floor, line_of_sight
from env.mdp.destinations import draw_destinations
from env.radio.mounting import inner_walls, see_each_other, sees
from env.radio.radio_map import build_radio_map
from env.seeding import Stream, stream

SIDE = 6
lattice = st.integers(0, SIDE).map(float)
halves = st.integers(0, 2 * SIDE).map(lambda n: n / 2)
places = st.tuples(lattice, lattice)
segment = st.tuples(lattice, lattice, lattice, lattice).filter(lambda s: s[:2] != s[2:])
walls_of = st.lists(segment, max_size=5)


def floor_of(walls, solid=False):
    return Floor(SIDE, SIDE, 1.0, np.array(walls, dtype=float).reshape(-1, 4), solid)


def outer(width_m, depth_m):
    """Walls round a room, the north one drawn in two parts that overlap, west from the top down."""
    return [
        [0.0, 0.0, width_m, 0.0],
        [width_m, 0.0, width_m, depth_m],
        [0.0, depth_m, 0.7 * width_m, depth_m],
        [0.4 * width_m, depth_m, width_m, depth_m],
        [0.0, depth_m, 0.0, 0.0],
    ]


def with_walls(config, more):
    walls = dataclasses.replace(config.walls, segments=[*config.walls.segments, *more])
    return dataclasses.replace(config, walls=walls)


def blocked_for_shapely(shapely, walls, device, point):
    """The rule in shapely's words: what a link and a wall share beyond the device blocks it."""
    edge = shapely.box(0, 0, SIDE, SIDE).exterior
    link = shapely.Point(device) if device == point else shapely.LineString([device, point])
    for x0, y0, x1, y1 in walls:
        wall = shapely.LineString([(x0, y0), (x1, y1)])
        along = edge.covers(wall) and (x0 == x1 or y0 == y1)
        hangs = device in ((x0, y0), (x1, y1))
        shared = link.intersection(wall)
        if not along and not shared.is_empty and not (hangs and shared == shapely.Point(device)):
            return True
    return False


@given(walls_of, places, st.lists(st.tuples(halves, halves), min_size=1, max_size=12))
def test_a_device_sees_what_shapely_says_that_no_wall_beyond_it_touches(walls, device, points):
    shapely = pytest.importorskip("shapely")
    found = sees(floor_of(walls), device, np.array(points))
    blocked = [blocked_for_shapely(shapely, walls, device, point) for point in points]
    assert found.tolist() == [not one for one in blocked]


@given(walls_of, places, places)
def test_two_devices_see_each_other_where_neither_is_blocked_beyond_both(walls, first, second):
    shapely = pytest.importorskip("shapely")
    at_one = [wall for wall in walls if first in (wall[:2], wall[2:])]
    others = [wall for wall in walls if wall not in at_one]
    blocked = blocked_for_shapely(shapely, at_one, first, second)
    blocked |= blocked_for_shapely(shapely, others, second, first)
    for pair in ((first, second), (second, first)):
        assert see_each_other(floor_of(walls), *pair).tolist() == [not blocked]


@given(walls_of, places, st.lists(st.tuples(halves, halves), min_size=1, max_size=8))
def test_walls_round_the_room_change_no_sight(walls, device, points):
    floor, closed = floor_of(walls), floor_of([*walls, *outer(SIDE, SIDE)])
    assert (sees(floor, device, np.array(points)) == sees(closed, device, np.array(points))).all()
    assert (inner_walls(floor) == inner_walls(closed)).all()


@given(walls_of, places, st.lists(st.tuples(halves, halves), min_size=1, max_size=8))
def test_walls_elsewhere_shade_as_they_do_for_any_link(walls, device, points):
    away = [wall for wall in walls if device not in (wall[:2], wall[2:])]
    floor = floor_of(away)
    expected = line_of_sight(np.array(device), np.array(points), inner_walls(floor))
    assert (sees(floor, device, np.array(points)) == expected).all()


@pytest.mark.parametrize("plan", ["default", "corridor", "hall"])
@pytest.mark.parametrize("response", ["coherent", "far"])
def test_a_plan_with_its_outer_walls_has_the_map_of_the_one_without(plan, response):
    config = checked_config({"plan": plan, "ris": {"response": response, "side": 8}})
    closed = with_walls(config, outer(config.room.width_m, config.room.depth_m))
    assert problems(closed) == []
    for first, second in zip(
        vars(build_radio_map(config)).values(), vars(build_radio_map(closed)).values(), strict=True
    ):
        assert np.asarray(first).tobytes() == np.asarray(second).tobytes()


def test_sides_that_are_no_whole_floats_have_edges_all_the_same():
    """0.1 * 3 is not 0.3: the edge of a room of three cells is where its walls are drawn."""
    floor = Floor(3, 3, 0.1, np.array([[0.3, 0.0, 0.3, 0.3], [0.0, 0.3, 0.3, 0.3]]))
    assert len(inner_walls(floor)) == 0
    assert sees(floor, (0.3, 0.15), floor.centres()).all()


def test_solid_walls_round_the_room_stop_nobody():
    free = floor_of([], solid=True)
    closed = floor_of(outer(SIDE, SIDE), solid=True)
    assert (closed.neighbours() == free.neighbours()).all()
    assert closed.drivable().all()
    goals = np.array([0, 17])
    assert (closed.slots_to(goals) == free.slots_to(goals)).all()


def test_a_wall_that_ends_at_the_surface_shades_only_along_itself():
    config = EnvConfig(walls=WallsConfig(segments=[[30.0, 7.5, 20.0, 7.5]]))
    away = EnvConfig(walls=WallsConfig(segments=[]))
    assert problems(config) == []
    seen, free = build_radio_map(config).ris_los, build_radio_map(away).ris_los
    assert free.all()
    assert seen.all()  # no centre lies on y = 7.5
    middle = dataclasses.replace(config, walls=WallsConfig(segments=[[30.0, 7.5, 27.0, 4.5]]))
    centres = Floor.from_config(middle).centres()
    along = np.abs((centres[:, 0] - 30.0) - (centres[:, 1] - 7.5)) < 1e-9
    assert along.sum() > 10
    assert (build_radio_map(middle).ris_los == ~along).all()


def test_the_surface_is_fed_past_the_end_of_a_wall_that_it_hangs_on():
    partition = EnvConfig(walls=WallsConfig(segments=[[30.0, 7.5, 20.0, 7.5]]))
    between = EnvConfig(walls=WallsConfig(segments=[[20.0, 15.0, 30.0, 15.0]]))
    free = EnvConfig(walls=WallsConfig(segments=[]))
    fed = [np.abs(build_radio_map(c).reflected).max() for c in (partition, free, between)]
    assert fed[0] == fed[1] > fed[2]


# Inside a wall.

SAY = "a place off the walls, at a wall's end or on the room's edge, and not inside {} of env.walls"


@pytest.mark.parametrize("device", ["ap", "ris"])
@pytest.mark.parametrize(
    ("segments", "named"),
    [
        ([[5.0, 20.0, 15.0, 20.0]], 0),
        ([[10.0, 25.0, 10.0, 3.0]], 0),
        ([[1.0, 1.0, 2.0, 2.0], [5.0, 15.0, 15.0, 25.0]], 1),
        ([[5.0, 20.0, 10.0, 20.0], [15.0, 20.0, 10.0, 20.0]], 0),  # one wall in two parts
        ([[5.0, 20.0, 10.0, 20.0], [8.0, 20.0, 15.0, 20.0]], 1),  # in parts that overlap
        ([[10.0, 20.0, 10.0, 25.0], [5.0, 20.0, 15.0, 20.0]], 1),  # where another one ends
    ],
)
def test_a_device_inside_a_wall_is_refused(device, segments, named):
    config = {"walls": {"segments": segments}, device: {"position_m": [10.0, 20.0, 2.0]}}
    with pytest.raises(ValueError, match=rf"^env\.{device}\.position_m=") as caught:
        checked_config(config)
    assert str(caught.value) == (
        f"env.{device}.position_m=[10.0, 20.0, 2.0]: allowed is"
        f" {SAY.format(segments[named])}.segments"
    )


@pytest.mark.parametrize(
    "segments",
    [
        [[5.0, 20.0, 10.0, 20.0]],
        [[5.0, 20.0, 10.0, 20.0], [10.0, 20.0, 10.0, 3.0]],  # a corner
        [[5.0, 20.0, 9.9, 20.0], [10.1, 20.0, 15.0, 20.0]],  # a gap
        [[5.0, 20.1, 15.0, 20.1]],
        [[11.0, 20.0, 15.0, 20.0]],  # on its line, not on it
    ],
)
@pytest.mark.parametrize("device", ["ap", "ris"])
def test_a_device_off_the_walls_or_at_an_end_is_allowed(device, segments):
    checked_config({"walls": {"segments": segments}, device: {"position_m": [10.0, 20.0, 2.0]}})


def test_a_surface_that_there_is_not_may_be_inside_a_wall():
    walls = WallsConfig(segments=[[5.0, 20.0, 15.0, 20.0]])
    for side, wrong in ((4, ["env.ris.position_m"]), (0, [])):
        ris = RisConfig(position_m=[10.0, 20.0, 2.0], side=side)
        assert [key for key, _, _ in problems(EnvConfig(walls=walls, ris=ris))] == wrong


@given(walls_of, places)
def test_a_device_is_inside_a_wall_where_shapely_finds_wall_on_both_sides(walls, device):
    shapely = pytest.importorskip("shapely")
    config = checked_config(
        {
            "robots": 1,
            "room": {"width_m": float(SIDE), "depth_m": float(SIDE), "cell_m": 1.0},
            "walls": {"segments": []},
            "ap": {"position_m": [*device, 2.0]},
            "ris": {"position_m": [0.0, 0.0, 2.0], "side": 0},
            "tasks": {"destinations_m": [[0.5, 0.5]], "start_distance_m": 1.0},
        }
    )
    inner = inner_walls(floor_of(walls))
    lines = [shapely.LineString([w[:2], w[2:]]) for w in inner]
    # Two points just beyond the device, opposite each other, that walls through it both hold.
    around = shapely.Point(device).buffer(1e-3).exterior
    hits = [
        np.array(point.coords[0]) - device
        for line in lines
        if line.distance(shapely.Point(device)) < 1e-12
        for point in getattr(line.intersection(around), "geoms", [line.intersection(around)])
    ]
    inside = any(np.linalg.norm(a + b) < 1e-5 for a in hits for b in hits)
    found = problems(with_walls(config, [list(wall) for wall in walls]))
    assert [key for key, _, _ in found] == (["env.ap.position_m"] if inside else [])


def test_destinations_and_starts_draw_what_they_drew():
    config = checked_config({"robots": 6})
    closed = with_walls(config, outer(30.0, 30.0))
    drawn = [draw_destinations(c, stream(0, Stream.DESTINATIONS)) for c in (config, closed)]
    assert (drawn[0] == drawn[1]).all()
