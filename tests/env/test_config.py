"""The schema of the group ``env``: every wrong value is named, with what is allowed."""

import dataclasses
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env.config import MAX_PHASE_ACTIONS, EnvConfig
from env.config_checks import problems
from env.radio.radio_map import build_radio_map
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World


def changed(value, changes):
    """A configuration with the values of some keys changed."""
    for key, new in changes.items():
        name, _, rest = key.partition(".")
        inner = changed(getattr(value, name), {rest: new}) if rest else new
        value = dataclasses.replace(value, **{name: inner})
    return value


def configured(**changes):
    """The defaults with changes such as ``ris__side=3``."""
    return changed(EnvConfig(), {key.replace("__", "."): new for key, new in changes.items()})


def leaves(value, above="env"):
    for item in dataclasses.fields(value):
        inner, key = getattr(value, item.name), f"{above}.{item.name}"
        if dataclasses.is_dataclass(inner):
            yield from leaves(inner, key)
        else:
            yield key, inner


def test_the_defaults_are_allowed():
    assert problems(EnvConfig()) == []


CHOICES = {
    "access": "noma or oma",
    "metric": "qos or qoe",
    "collisions": "allow or block",
    "oma.share": "fixed or reallocate",
    "tasks.destination": "one of fixed, random, common",
    "tasks.start": "random or fixed",
    "ris.response": "one of coherent, far, near, rayleigh",
    "ris.axis": "x or y",
    "ris.action": "phases or codebook",
    "channel.fading": "one of static, none, slot",
    "channel.los_phase": "zero or distance",
    "power.resolve": "one of project, residual, zero",
    "state.destination": "offset or none",
    "state.way": "one of auto, on, off",
    "state.order": "index or gain",
    "reward.distance": "one of auto, straight, way",
    "reward.credit": "one of rate, team, difference",
    "reward.weights": "equal or objective",
}


@pytest.mark.parametrize("key", [*CHOICES])
def test_a_choice_that_does_not_exist_is_named_with_those_that_do(key):
    found = problems(changed(EnvConfig(), {key: "bogus"}))
    assert found == [(f"env.{key}", "bogus", CHOICES[key])]


@pytest.mark.parametrize(
    "key", [key for key, value in leaves(EnvConfig()) if isinstance(value, float)]
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_refused(key, value):
    found = problems(changed(EnvConfig(), {key.removeprefix("env."): value}))
    assert [(name, say) for name, _, say in found] == [(key, "a finite number")]


@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("env.room.cell_m", 0.0, "a number above 0"),
        ("env.motion.speed_mps", 0.0, "a number above 0"),
        ("env.motion.idle_power_w", -0.1, "a number above 0"),
        ("env.channel.frequency_ghz", 0.0, "a number above 0"),
        ("env.noise.bandwidth_hz", 0.0, "a number above 0"),
        ("env.map_seed", -1, "a number of at least 0"),
        ("env.state.others", -1, "a number from 0 to 63"),
        ("env.motion.energy_per_m_j", -1.0, "a number of at least 0"),
        ("env.motion.antenna_height_m", -1.0, "a number of at least 0"),
        ("env.tasks.destination_spacing_m", -1.0, "a number of at least 0"),
        ("env.tasks.start_distance_m", -1.0, "a number of at least 0"),
        ("env.power.sic_margin", -1.0, "a number of at least 0"),
        ("env.qoe.scale", 0.0, "a number above 0"),
        ("env.qoe.floor", 0.0, "a number above 0"),
        ("env.reward.guidance_discount", 0.0, "a number above 0 and at most 1"),
        ("env.reward.guidance_discount", 1.01, "a number above 0 and at most 1"),
        ("env.reward.horizon_slots", 0.0, "a number above 0 and at most 1000000"),
        ("env.robots", 0, "a number from 1 to 64"),
        ("env.robots", 65, "a number from 1 to 64"),
        ("env.ris.side", -1, "a number from 0 to 256"),
        ("env.ris.side", 257, "a number from 0 to 256"),
        ("env.ris.bits", 0, "a number from 1 to 12"),
        ("env.ris.bits", 13, "a number from 1 to 12"),
        ("env.ris.subsurfaces", 0, "a number from 1 to 65536"),
        ("env.ris.spacing", 0.0, "a number from 0.01 to 100"),
        ("env.ris.spacing", 101.0, "a number from 0.01 to 100"),
        ("env.power.levels", 0, "a number from 1 to 48"),
        ("env.power.levels", 49, "a number from 1 to 48"),
        ("env.power.max_dbm", 61.0, "a number from -60 to 60"),
        ("env.motion.max_slots", 0, "a number from 1 to 1000000"),
        ("env.room.width_m", 0.5, "a number from 1 to 1000"),
        ("env.room.depth_m", 1001.0, "a number from 1 to 1000"),
        ("env.room.width_m", 30.2, "a multiple of env.room.cell_m=0.5, at least two"),
        ("env.room.depth_m", 30.2, "a multiple of env.room.cell_m=0.5, at least two"),
        ("env.room.cell_m", 0.01, "a side with at most 250000 cells"),
        ("env.tasks.start_distance_m", 100.0, "at most 32.1, since no cell is farther"),
    ],
)
def test_a_number_out_of_range_is_named_with_the_range(key, value, allowed):
    found = problems(changed(EnvConfig(), {key.removeprefix("env."): value}))
    assert [name for name, _, _ in found] == [key]
    assert found[0][1] == value
    assert found[0][2].startswith(allowed)


@pytest.mark.parametrize(
    ("key", "value", "wrong", "allowed"),
    [
        ("ap.position_m", [15.0, 30.0], None, "[x, y, z]"),
        ("ap.position_m", [15.0, 30.5, 2.0], None, "inside the room or on its edge"),
        ("ap.position_m", [15.0, 30.0, -0.1], None, "[x, y, z]"),
        ("ris.position_m", [-0.1, 7.5, 2.0], None, "inside the room or on its edge"),
        ("ris.position_m", [30.0, 7.5, math.inf], None, "[x, y, z]"),
        ("walls.segments", [[0, 15, 21]], [0, 15, 21], "[x0, y0, x1, y1]"),
        ("walls.segments", [[1.0, 2.0, 1.0, 2.0]], [1.0, 2.0, 1.0, 2.0], "[x0, y0, x1, y1]"),
        ("walls.segments", [7], 7, "[x0, y0, x1, y1]"),
        ("walls.segments", [[0, 15, 21, "a"]], [0, 15, 21, "a"], "[x0, y0, x1, y1]"),
        ("tasks.destinations_m", [[30.0, 1.0]], [30.0, 1.0], "inside the room of 30 m x 30 m"),
        ("tasks.destinations_m", [[1.0, 1.0, 1.0]], [1.0, 1.0, 1.0], "[x, y] inside the room"),
        ("tasks.destinations_m", [[1.0, 1.0], [1.4, 1.4]], [1.4, 1.4], "cells of their own"),
    ],
)
def test_a_place_that_does_not_fit_the_room_is_named(key, value, wrong, allowed):
    found = problems(changed(EnvConfig(), {key: value}))
    assert [(name, at) for name, at, _ in found] == [(f"env.{key}", wrong or value)]
    assert allowed in found[0][2]


def test_destinations_are_told_apart_as_the_floor_tells_cells_apart():
    """1.0 / 0.1 is 10, though 1.0 // 0.1 is 9: both places lie in one cell."""
    config = configured(room__cell_m=0.1, tasks__destinations_m=[[1.0, 0.5], [1.05, 0.5]])
    assert [key for key, _, _ in problems(config)] == ["env.tasks.destinations_m"]


def test_subsurfaces_must_divide_the_elements():
    found = problems(configured(ris__subsurfaces=7))
    assert found == [
        ("env.ris.subsurfaces", 7, "a divisor of the 900 elements that env.ris.side=30 gives")
    ]


def test_the_access_points_actions_are_bounded():
    assert problems(configured(ris__subsurfaces=6)) == []
    [(key, value, allowed)] = problems(configured(ris__subsurfaces=9))
    assert (key, value) == ("env.ris.subsurfaces", 9)
    assert allowed.startswith(f"at most {MAX_PHASE_ACTIONS} phase settings")
    assert "6 sub-surfaces or fewer" in allowed


def test_projecting_needs_a_level_for_each_robot_and_the_other_rules_do_not():
    [(key, value, allowed)] = problems(configured(robots=4, power__levels=3))
    assert (key, value) == ("env.power.levels", 3)
    assert allowed.startswith("at least env.robots=4 with env.power.resolve=project")
    for resolve in ("residual", "zero"):
        assert problems(configured(robots=4, power__levels=3, power__resolve=resolve)) == []


def test_orthogonal_access_needs_no_level_for_each_robot():
    assert problems(configured(robots=4, power__levels=3, access="oma")) == []


@pytest.mark.parametrize("resolve", ["residual", "zero"])
def test_the_difference_that_a_signal_makes_is_known_where_all_signals_are_cancelled(resolve):
    changes = {"reward__credit": "difference", "power__resolve": resolve}
    [(key, value, allowed)] = problems(configured(**changes))
    assert (key, value) == ("env.reward.credit", "difference")
    assert allowed.startswith(f"rate or team with env.power.resolve={resolve}")
    assert problems(configured(**changes, access="oma")) == []


FOUR_STARTS = [[1.0, 1.0], [2.0, 1.0], [3.0, 1.0], [4.25, 10.25]]


@pytest.mark.parametrize(
    ("starts", "destination", "wrong", "allowed"),
    [
        ([[1.0, 1.0]], "fixed", [[1.0, 1.0]], "at least env.robots=3 places"),
        ([], "fixed", [], "at least env.robots=3 places with env.tasks.start=fixed"),
        ([*FOUR_STARTS, [1.0, 30.0]], "fixed", [1.0, 30.0], "inside the room of 30 m x 30 m"),
        ([*FOUR_STARTS[:2], [1.0]], "fixed", [1.0], "[x, y] inside the room"),
        ([[27.4, 12.1], *FOUR_STARTS], "fixed", [27.4, 12.1], "off the cell of the robot's dest"),
        ([*FOUR_STARTS[:2], [27.4, 12.1]], "common", [27.4, 12.1], "off the cell of the robot's"),
    ],
)
def test_fixed_starts_that_do_not_fit_are_named(starts, destination, wrong, allowed):
    config = configured(
        tasks__start="fixed", tasks__starts_m=starts, tasks__destination=destination
    )
    [(key, value, say)] = problems(config)
    assert (key, value) == ("env.tasks.starts_m", wrong)
    assert allowed in say


@pytest.mark.parametrize("destination", ["fixed", "random", "common"])
def test_fixed_starts_may_be_another_robots_destination_and_any_distance_away(destination):
    tasks = {"start": "fixed", "starts_m": FOUR_STARTS[::-1], "start_distance_m": 100.0}
    changes = {f"tasks__{key}": value for key, value in tasks.items()}
    assert problems(configured(tasks__destination=destination, **changes)) == []


def test_a_far_start_is_refused_where_all_destinations_are_drawn():
    assert problems(configured(tasks__destination="common", tasks__start_distance_m=25.0)) == []
    [(key, _, _)] = problems(configured(tasks__destination="random", tasks__start_distance_m=25.0))
    assert key == "env.tasks.start_distance_m"


def test_every_problem_is_listed_at_once():
    found = problems(configured(robots=0, access="cdma", ris__bits=99))
    assert {key for key, _, _ in found} == {"env.robots", "env.access", "env.ris.bits"}


def test_a_far_start_is_refused_where_a_drawn_destination_could_lie_in_the_middle():
    # The farthest cell from the middle is 21.2 m away, from the given destinations 32 m.
    assert problems(configured(robots=4, tasks__start_distance_m=25.0)) == []
    [(key, _, _)] = problems(configured(robots=5, tasks__start_distance_m=25.0))
    assert key == "env.tasks.start_distance_m"


@given(
    st.floats(2, 20),
    st.floats(2, 20),
    st.sampled_from([0.25, 0.5, 1.0]),
    st.floats(0, 25),
    st.integers(0, 100),
    st.booleans(),
)
@settings(max_examples=40)
def test_every_robot_of_an_allowed_configuration_has_somewhere_to_start(
    width, depth, cell_m, start_m, seed, drawn
):
    width_m, depth_m = (max(2, round(side / cell_m)) * cell_m for side in (width, depth))
    config = configured(
        robots=2,
        room__width_m=width_m,
        room__depth_m=depth_m,
        room__cell_m=cell_m,
        ap__position_m=[0.0, 0.0, 2.0],
        ris__position_m=[width_m, depth_m, 2.0],
        tasks__destinations_m=[] if drawn else [[0.1, 0.1], [width_m / 2, depth_m / 2]],
        tasks__destination_spacing_m=0.1,
        tasks__start_distance_m=start_m,
    )
    if not problems(config):
        world = World(Scenario.drawn(config, seed), stream(seed, Stream.WORLD))
        world.reset()
        assert world.driving.all()


@pytest.mark.parametrize("key", [key for key, _ in leaves(EnvConfig())])
def test_a_configuration_cannot_be_changed_in_place(key):
    *path, name = key.split(".")[1:]
    group = EnvConfig()
    for part in path:
        group = getattr(group, part)
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(group, name, None)


def test_table_1_of_the_paper():
    config = EnvConfig()
    assert config.room.cell_m == 0.5
    assert (config.motion.speed_mps, config.motion.energy_per_m_j) == (0.5, 7.4)
    assert config.motion.idle_power_w == 0.29
    assert (config.reward.time, config.reward.goal, config.reward.sum_rate) == (-1.0, 100.0, 0.1)
    assert (config.ap.position_m, config.ris.position_m) == ([15.0, 30.0, 2.0], [30.0, 7.5, 2.0])
    assert (config.power.max_dbm, config.noise.density_dbm_per_hz) == (20.0, -100.0)


def test_allowed_settings_build_a_map():
    tables = build_radio_map(configured(ris__subsurfaces=6, ris__side=30))
    assert tables.settings.shape == (4096, 6)
