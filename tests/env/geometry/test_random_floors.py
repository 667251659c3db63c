"""Floors from a seed."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from conf import ConfigError, compose, from_yaml, to_yaml
from env.apis.parallel_env import RISFleetParallelEnv
from env.checks import checked_config, planned_config
from env.config_checks import problems
from env.geometry import floor_plans, random_floors
from env.geometry.floor import UNREACHABLE, Floor
from env.geometry.random_floors import random_plan
from env.radio.mounting import see_each_other, sees
from env.seeding import Stream, stream
from server_app.app import _asked as asked_on_flower

SEEDS = range(20)
plan_of = cache(random_plan)
"""Not to be changed."""
each_seed = pytest.mark.parametrize("seed", SEEDS[:8])


def floor_of(plan):
    room, segments = plan["room"], plan["walls"]["segments"]
    columns, rows = (round(room[side] / room["cell_m"]) for side in ("width_m", "depth_m"))
    return Floor(columns, rows, room["cell_m"], np.array(segments), plan["walls"]["block_motion"])


def dividing_walls(segments):
    """The two parts of each wall, shape (walls, 2, 2, 2), and the two posts of each door."""
    parts = np.array(segments).reshape(-1, 2, 2, 2)
    return parts, np.stack([parts[:, 0, 1], parts[:, 1, 0]], axis=1)


# Walls and doors.


@each_seed
def test_every_cell_reaches_every_other(seed):
    floor = floor_of(plan_of(seed))
    assert floor.solid
    assert floor.slots_to(np.array([0])).max() < UNREACHABLE


@each_seed
def test_three_to_six_rooms_are_parts_of_their_own_once_doors_are_shut(seed):
    plan, rooms = plan_of(seed), 0
    parts, _ = dividing_walls(plan["walls"]["segments"])
    shut = np.concatenate([parts[:, 0, 0], parts[:, 1, 1]], axis=-1)
    floor = replace(floor_of(plan), walls=shut)
    left = np.ones(floor.cells, dtype=bool)
    while left.any():
        room = floor.slots_to(np.flatnonzero(left)[:1])[:, 0] < UNREACHABLE
        place = np.flatnonzero(room)
        for cells in (place % floor.columns, place // floor.columns):
            assert (np.ptp(cells) + 1) * floor.cell_m >= 5
        left &= ~room
        rooms += 1
    assert rooms == len(parts) + 1
    assert 3 <= rooms <= 6


def test_floors_have_all_numbers_of_rooms():
    assert {len(plan_of(seed)["walls"]["segments"]) // 2 for seed in SEEDS} == {2, 3, 4, 5}


@each_seed
def test_walls_lie_on_the_borders_of_cells_and_doors_are_two_or_three_metres_wide(seed):
    plan = plan_of(seed)
    walls, floor = np.array(plan["walls"]["segments"]), floor_of(plan)
    assert (walls % floor.cell_m == 0).all()
    assert (walls >= 0).all()
    assert (walls.reshape(-1, 2) <= floor.size_m).all()
    assert ((walls[:, 0] == walls[:, 2]) ^ (walls[:, 1] == walls[:, 3])).all()
    _, posts = dividing_walls(walls)
    assert {*np.linalg.norm(posts[:, 1] - posts[:, 0], axis=-1)} <= {2.0, 3.0}


def test_no_wall_ends_in_a_door():
    for seed in range(200):
        walls = random_floors._divided(stream(seed, Stream.FLOOR), 20, 20)
        parts, posts = dividing_walls(walls)
        for first, last in posts:
            to_posts = np.linalg.norm(parts - first, axis=-1) + np.linalg.norm(
                parts - last, axis=-1
            )
            inside = to_posts < np.linalg.norm(last - first) + 1e-9
            at_a_post = (parts == first).all(-1) | (parts == last).all(-1)
            assert (inside == (inside & at_a_post)).all()


@each_seed
def test_sides_are_whole_metres_from_20_to_30(seed):
    sides = [plan_of(seed)["room"][side] for side in ("width_m", "depth_m")]
    assert all(20 <= side <= 30 and side % 1 == 0 for side in sides)


def test_a_floor_in_parts_is_drawn_again(monkeypatch):
    divided, calls = random_floors._divided, []

    def shut_at_first(draw, width, depth):
        calls.append((width, depth))
        return [[0.0, 10.0, width, 10.0]] if len(calls) < 3 else divided(draw, width, depth)

    monkeypatch.setattr(random_floors, "_divided", shut_at_first)
    plan = random_plan(0)
    assert len(calls) == 3
    assert calls[2] == (plan["room"]["width_m"], plan["room"]["depth_m"])
    assert floor_of(plan).drivable().all()


# Devices, destinations, slots.


@each_seed
def test_the_access_point_and_the_surface_hang_on_two_outer_walls(seed):
    plan = plan_of(seed)
    size_m, sides = floor_of(plan).size_m, []
    for device in ("ap", "ris"):
        *place, height_m = plan[device]["position_m"]
        assert height_m == 2.0
        [side] = [
            (axis, far)
            for axis in (0, 1)
            for far in (0, 1)
            if place[axis] == far * size_m[axis] and 0 < place[1 - axis] < size_m[1 - axis]
        ]
        sides.append(side)
    assert sides[0] != sides[1]
    assert plan["ris"]["axis"] == ("y" if sides[1][0] == 0 else "x")


def test_devices_hang_on_every_side():
    found: dict[str, set] = {"ap": set(), "ris": set()}
    for seed in SEEDS:
        plan = plan_of(seed)
        size_m = floor_of(plan).size_m
        for device, sides in found.items():
            x, y, _ = plan[device]["position_m"]
            sides.add((x == 0, x == size_m[0], y == 0, y == size_m[1]))
    assert [len(sides) for sides in found.values()] == [4, 4]


def sight(seed):
    """Whether the RIS sees the AP, and how many cells of the AP's shadow it sees."""
    plan = random_plan(seed)
    floor, ap_m, ris_m = floor_of(plan), plan["ap"]["position_m"], plan["ris"]["position_m"]
    lit, reached = (sees(floor, device_m, floor.centres()) for device_m in (ap_m, ris_m))
    return bool(see_each_other(floor, ap_m, ris_m)[0]), int((reached & ~lit).sum())


def test_of_the_drawn_places_those_are_taken_where_the_surface_sees_most(monkeypatch):
    chosen = [sight(seed) for seed in SEEDS]
    monkeypatch.setattr(random_floors, "MOUNTS", 1)
    first = [sight(seed) for seed in SEEDS]
    pairs = [*zip(chosen, first, strict=True)]
    assert all(best >= one for best, one in pairs)
    assert any(fed == one[0] and shadow > one[1] for (fed, shadow), one in pairs)
    assert sum(fed for fed, _ in chosen) > 0.8 * len(SEEDS) > sum(fed for fed, _ in first)


@each_seed
def test_destinations_are_four_centres_of_cells_at_least_five_metres_apart(seed):
    plan = plan_of(seed)
    goals_m, floor = np.array(plan["tasks"]["destinations_m"]), floor_of(plan)
    assert goals_m.shape == (4, 2)
    assert (floor.centres()[floor.cell_at(goals_m)] == goals_m).all()
    apart_m = np.linalg.norm(goals_m[:, None] - goals_m, axis=-1)
    assert apart_m[~np.eye(4, dtype=bool)].min() >= 5


@each_seed
def test_the_longest_way_between_any_two_cells_fits_into_an_episode(seed):
    plan = plan_of(seed)
    floor, most = floor_of(plan), plan["motion"]["max_slots"]
    to_goals = floor.slots_to(floor.cell_at(np.array(plan["tasks"]["destinations_m"])))
    assert most == max(150, 2 * to_goals.max())
    assert floor.slots_to(to_goals.argmax(axis=0)).max() <= most


# As a plan.


@each_seed
@pytest.mark.parametrize("robots", [1, 4])
def test_a_drawn_floor_passes_the_checks_of_the_environment(seed, robots):
    config = replace(planned_config(f"random:{seed}"), robots=robots)
    assert problems(config) == []
    assert config.walls.segments == plan_of(seed)["walls"]["segments"]


def test_a_plan_is_its_seeds():
    assert [random_plan(seed) for seed in SEEDS] == [plan_of(seed) for seed in SEEDS]
    for group in ("walls", "tasks"):
        assert len({json.dumps(plan_of(seed)[group]) for seed in SEEDS}) == len(SEEDS)


def test_a_drawn_floor_sets_what_a_plan_may_set():
    keys = {f"{group}.{key}" for group, inner in random_plan(0).items() for key in inner}
    assert keys == {*floor_plans.KEYS}


def test_a_seed_gives_the_same_floor_in_every_version():
    plan = random_plan(0)
    assert plan["room"] == {"width_m": 28.0, "depth_m": 23.0, "cell_m": 0.5}
    assert plan["walls"]["segments"] == [
        [20.0, 0.0, 20.0, 6.0],
        [20.0, 9.0, 20.0, 23.0],
        [0.0, 11.0, 7.0, 11.0],
        [9.0, 11.0, 20.0, 11.0],
    ]
    goals_m = [[15.75, 10.25], [11.25, 1.25], [1.75, 20.25], [21.25, 19.75]]
    assert plan["tasks"]["destinations_m"] == goals_m
    assert plan["ap"] == {"position_m": [28.0, 10.5, 2.0]}
    assert plan["ris"] == {"position_m": [0.0, 1.5, 2.0], "axis": "y"}
    assert plan["motion"]["max_slots"] == 206


def test_the_views_and_the_command_have_the_same_floor():
    composed = compose(["env.plan=random:7", "env.robots=2"]).env
    assert composed.plan == "random:7"
    assert composed == checked_config({"plan": "random:7", "robots": 2})
    assert RISFleetParallelEnv({"plan": "random:7", "robots": 2}).config == composed
    assert asked_on_flower(["env.plan=random:7", "env.robots=2"])[0].env == composed
    whole = compose(["env.plan=random:7"])
    assert whole.env == planned_config("random:7")
    assert from_yaml(to_yaml(whole)) == whole


def test_an_override_wins_over_a_drawn_floor():
    assert compose(["env.plan=random:7", "env.motion.max_slots=500"]).env.motion.max_slots == 500


@pytest.mark.parametrize("seed", ["0", "7", "9" * 18])
def test_a_seed_is_found_in_the_name(seed):
    assert floor_plans.find(f"random:{seed}") == int(seed)
    assert floor_plans.read(f"random:{seed}") == random_plan(int(seed))


WRONG = ["", ":", ":x", ":-1", ":+1", ":1.5", ":7:8", ":7.toml", ":1_0", ":\u0667", f":1{'0' * 18}"]


@pytest.mark.parametrize("rest", WRONG)
def test_a_name_without_a_seed_is_refused_in_one_sentence(tmp_path, monkeypatch, rest):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "random").write_text("")  # no file goes by that name
    allowed = "random:SEED with a whole number of at most 18 digits, as in random:7"
    said = f"env.plan=random{rest}: allowed is {allowed}"
    for refuse in (floor_plans.read, planned_config, lambda name: checked_config({"plan": name})):
        with pytest.raises(ValueError, match="allowed is") as caught:
            refuse(f"random{rest}")
        assert str(caught.value) == said
    with pytest.raises(ConfigError) as caught:
        compose([f"env.plan='random{rest}'"])
    assert str(caught.value) == f"{said}."
