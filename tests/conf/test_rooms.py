"""The rooms of a building: drawn from a seed, dealt in turn, and checked room by room."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conf import (
    Config,
    ConfigError,
    compose,
    flower_clients,
    has_rooms,
    overridden,
    problems,
    robot_network,
)
from conf.rooms import Room, from_json, room_name, rooms_of, to_json
from env.geometry import floor_plans

Building = Callable[..., Config]
Compose = Callable[[list[str]], Config]

TWO_WALLS = """
[room]
width_m = 12.0
depth_m = 9.0
cell_m = 1.0

[walls]
segments = [[3.0, 4.0, 8.0, 4.0]]
block_motion = true

[ap]
position_m = [6.0, 9.0, 2.0]

[ris]
position_m = [12.0, 3.0, 2.0]

[tasks]
destinations_m = [[10.5, 1.5], [1.5, 1.5]]
start_distance_m = 2.0
destination_spacing_m = 2.0
"""


@pytest.fixture(scope="module")
def building() -> Building:
    """A building on the default floor, with values set as on a command line."""
    base = compose(["runtime=local", "env.robots=2", "rooms.count=4"])

    def make(*overrides: str) -> Config:
        return overridden(base, overrides)

    return make


@pytest.fixture
def own_plan(tmp_path: Path) -> Path:
    """A user's floor plan, whose walls stop robots."""
    path = tmp_path / "two_walls.toml"
    path.write_text(TWO_WALLS)
    return path


# --- Drawn from a seed ----------------------------------------------------------------------------


@settings(max_examples=10)
@given(seed=st.integers(0, 2**63), count=st.integers(2, 6), held_out=st.integers(0, 3))
def test_a_further_room_changes_none_before_it(
    tiny_building: Building, seed: int, count: int, held_out: int
) -> None:
    given_ = {"seed": seed, "rooms.count": count, "rooms.held_out": held_out}
    rooms = rooms_of(tiny_building(given_), check=False)
    more = {**given_, "rooms.count": count + 1, "rooms.held_out": held_out + 1}
    others = {room.name: room for room in rooms_of(tiny_building(more), check=False)}
    assert [room.held_out for room in rooms] == [False] * count + [True] * held_out
    assert [others[room.name] for room in rooms] == rooms
    assert len(others) == count + held_out + 2


def test_rooms_have_seeds_and_radio_maps_of_their_own(tiny_building: Building) -> None:
    config = tiny_building({"rooms.count": 20, "rooms.held_out": 20})
    rooms = rooms_of(config, check=False)
    assert len({room.seed for room in rooms}) == 40
    assert [room.env["map_seed"] for room in rooms] == [room.seed for room in rooms]
    assert {room.seed for room in rooms_of(tiny_building({"seed": 1}))}.isdisjoint(
        room.seed for room in rooms
    )


def test_a_room_is_a_run_of_one_room_with_the_buildings_learners(tiny_building: Building) -> None:
    config = tiny_building({"federation.clients": 3, "runtime.name": "deployment"})
    room = rooms_of(config)[1]
    own = room.config(config)
    assert not has_rooms(own)
    assert (own.seed, own.env.map_seed, own.train.max_ticks) == (room.seed, room.seed, None)
    assert (own.agent, own.strategy, own.env.tasks) == (
        config.agent, config.strategy, config.env.tasks,
    )  # fmt: skip
    assert problems(own) == []


@pytest.mark.parametrize(
    ("index", "held_out", "name"), [(0, False, "0000"), (12, True, "held-out-0012")]
)
def test_a_room_is_called_by_its_number(index: int, held_out: bool, name: str) -> None:
    assert room_name(index, held_out=held_out) == Room(index, held_out, 1, {}).name == name


# --- Dealt in turn --------------------------------------------------------------------------------


def test_plans_and_robots_are_dealt_in_turn(building: Building) -> None:
    config = building("rooms.plans=[default,corridor,hall]", "rooms.robots=[2,3]")
    config = overridden(config, ["rooms.count=7", "rooms.held_out=2"])
    rooms = rooms_of(config, check=False)
    envs = [room.config(config).env for room in rooms]
    plans, robots = [env.plan for env in envs], [env.robots for env in envs]
    assert plans[:7] == ["default", "corridor", "hall"] * 2 + ["default"]
    assert plans[7:] == ["default", "corridor"]
    assert robots == [2, 3, 2, 3, 2, 3, 2, 2, 3]
    corridor = compose(["env.plan=corridor"]).env
    assert (envs[1].room, envs[1].walls, envs[1].ap, envs[1].tasks) == (
        corridor.room, corridor.walls, corridor.ap, corridor.tasks,
    )  # fmt: skip


def test_random_is_a_floor_of_its_own_for_each_room(building: Building) -> None:
    config = building("rooms.plans=[random]", "rooms.count=3", "rooms.held_out=1")
    rooms = rooms_of(config)
    envs = [room.config(config).env for room in rooms]
    assert [env.plan for env in envs] == [f"random:{room.seed}" for room in rooms]
    assert len({str(env.walls.segments) for env in envs}) == 4
    for env in envs:
        assert env.walls.segments == floor_plans.read(env.plan)["walls"]["segments"]


def test_a_users_plan_is_read_once_and_its_file_is_not_needed_again(
    building: Building, own_plan: Path
) -> None:
    config = building(f"rooms.plans=[{own_plan}]", "rooms.count=2")
    rooms = from_json(to_json(rooms_of(config)))
    own_plan.unlink()
    env = rooms[1].config(config).env
    assert (env.plan, env.room.width_m, env.walls.segments) == (str(own_plan), 12.0, [[3, 4, 8, 4]])
    assert problems(rooms[1].config(config)) == []


def test_what_the_user_sets_above_the_plan_stays(building: Building, own_plan: Path) -> None:
    plans = f"rooms.plans=[default,{own_plan}]"
    free, config = building(plans), building(plans, "env.tasks.start_distance_m=4")
    tasks = [room.config(config).env.tasks for room in rooms_of(config)]
    assert [each.start_distance_m for each in tasks] == [4.0] * 4
    others = [room.config(free).env.tasks for room in rooms_of(free)]
    assert [each.start_distance_m for each in others[1::2]] == [2.0] * 2
    assert others[0].start_distance_m not in (2.0, 4.0)
    assert [each.destinations_m for each in tasks] == [each.destinations_m for each in others]


def test_robots_of_all_rooms_see_the_way_where_any_rooms_walls_stop_them(
    building: Building, own_plan: Path
) -> None:
    for plans, way in (("default", "off"), (f"default,{own_plan}", "on")):
        config = building(f"rooms.plans=[{plans}]", "rooms.held_out=1")
        assert config.env.state.way == "auto"
        own = [room.config(config) for room in rooms_of(config)]
        assert {each.env.state.way for each in own} == {way}
        assert len({robot_network(each) for each in own}) == 1
    stays = building(f"rooms.plans=[{own_plan}]", "env.state.way=off")
    assert {room.config(stays).env.state.way for room in rooms_of(stays)} == {"off"}


# --- As text --------------------------------------------------------------------------------------

LEAVES = st.integers(0, 9) | st.floats(allow_nan=False) | st.text(max_size=3) | st.booleans()
ROOMS = st.builds(
    Room,
    st.integers(0, 9999),
    st.booleans(),
    st.integers(0, 2**32 - 1),
    st.dictionaries(st.text(max_size=4), LEAVES | st.lists(LEAVES, max_size=2), max_size=3),
)


@settings(max_examples=25)
@given(rooms=st.lists(ROOMS, max_size=3))
def test_rooms_come_back_from_their_text(rooms: list[Room]) -> None:
    text = to_json(rooms)
    assert from_json(text) == rooms
    assert text.count("\n") == max(1, len(rooms))


@pytest.mark.parametrize("plans", ["", "random,corridor"])
def test_the_rooms_of_a_building_come_back_from_their_text(building: Building, plans: str) -> None:
    rooms = rooms_of(building(f"rooms.plans=[{plans}]"), check=False)
    assert from_json(to_json(rooms)) == rooms


WHOLE = {"index": 0, "held_out": False, "seed": 1, "env": {}}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[",
        "5",
        "[5]",
        '["index"]',
        json.dumps([{**WHOLE, "more": 1}]),
        json.dumps([{"index": 0}]),
        *(
            json.dumps([{**WHOLE, name: value}])
            for name, value in [
                ("index", -1),
                ("index", "0"),
                ("index", True),
                ("held_out", 0),
                ("seed", -1),
                ("seed", 1.5),
                ("env", []),
                ("env", None),
            ]
        ),
    ],
)
def test_text_that_is_of_no_rooms_is_refused(text: str) -> None:
    assert from_json(json.dumps([WHOLE])) == [Room(0, False, 1, {})]
    with pytest.raises(ValueError, match=r"."):
        from_json(text)


# --- What is allowed ------------------------------------------------------------------------------

MISTAKES = [
    (
        ["rooms.count=5", "rooms.strategy.name=krum", "rooms.fraction=0.4"],
        "rooms.strategy.name=krum: allowed is rooms.fraction * rooms.count of at least 3, not 2",
    ),
    (
        ["rooms.count=2", "rooms.strategy.name=fedprox", "rooms.strategy.proximal_mu=0.1"],
        "rooms.strategy.name=fedprox: allowed is any other across rooms",
    ),
    (["rooms.count=0"], "rooms.count=0: allowed is a number from 1 to 10000."),
    (["rooms.count=2", "rooms.every=0"], "rooms.every=0: allowed is a number from 1 to"),
    (["rooms.count=2", "rooms.fraction=0"], "rooms.fraction=0.0: allowed is"),
    (["rooms.count=2", "rooms.fraction=1.5"], "rooms.fraction=1.5: allowed is"),
    (
        ["rooms.count=2", "rooms.access_points=all"],
        "rooms.access_points=all: allowed is own or m",
    ),
    (["rooms.plans=[hall]"], "rooms.plans=['hall']: allowed is not set with rooms.count=1"),
    (["rooms.robots=[2]"], "rooms.robots=[2]: allowed is not set with rooms.count=1"),
    (["rooms.every=2"], "rooms.every=2: allowed is not set with rooms.count=1"),
    (["rooms.access_points=mean"], "rooms.access_points=mean: allowed is not set with rooms.c"),
    (["rooms.fraction=0.5"], "rooms.fraction=0.5: allowed is not set with rooms.count=1"),
    (["rooms.evaluated=2"], "rooms.evaluated=2: allowed is not set with rooms.count=1"),
    (["rooms.strategy.momentum=0.5"], "allowed is not set with rooms.count=1"),
    (
        ["rooms.count=2", "baseline=centralized"],
        "rooms.count=2: allowed is 1 with scheme.agents=centralized and scheme.robots=learned: ",
    ),
    (
        ["rooms.count=2", "baseline=shortest_best"],
        "rooms.count=2: allowed is 1 with scheme.agents=federated and scheme.robots=shortest_best",
    ),
    (["rooms.count=2", "strategy.name=none"], "strategy.name=none: allowed is any other "),
    (
        ["rooms.count=2", "federation.windows_per_round=2"],
        "federation.windows_per_round=2: allowed is null in a building: ",
    ),
    (["rooms.count=2", "rooms.robots=[2,0]"], "rooms.robots=[2,0]: allowed is a list of numbers"),
    (["rooms.count=2", "rooms.robots=[65]"], "rooms.robots=[65]: allowed is a list of numbers fr"),
    (["rooms.count=2", "rooms.plans=[3]"], "rooms.plans=[3]: allowed is a list of names and "),
    (
        ["rooms.count=2", "rooms.strategy.name=none"],
        "rooms.strategy.name=none: allowed is any other: rooms that share nothing are runs",
    ),
    (
        ["rooms.count=2", "rooms.strategy.name=best"],
        "rooms.strategy.name=best: allowed is one of ",
    ),
    (
        ["rooms.count=2", "rooms.strategy.name=krum"],
        "rooms.strategy.name=krum: allowed is rooms.count of at least 3, not 2",
    ),
    (
        ["rooms.count=5", "rooms.strategy.name=krum", "rooms.strategy.malicious=2"],
        "rooms.strategy.malicious=2: allowed is from 0 to 1: Krum needs rooms.count=5 to be",
    ),
    (
        ["rooms.count=2", "rooms.strategy.momentum=0.5"],
        "rooms.strategy.momentum=0.5: allowed is 0.0 with strategy=fedavg: only ",
    ),
    (
        ["rooms.count=3", "federation.clients=4"],
        "federation.clients=4: allowed is a number from 1 to rooms.count=3, or null",
    ),
    (
        ["runtime.name=deployment", "federation.on_loss=miss"],
        "federation.on_loss=miss: allowed is wait or abort here: rooms of a building in a deploy",
    ),
    (
        ["runtime.name=simulation", "rooms.count=2", "federation.on_loss=miss"],
        "federation.on_loss=miss: allowed is wait or abort here",
    ),
]


@pytest.mark.parametrize(("overrides", "message"), MISTAKES)
def test_a_mistake_in_a_building_costs_one_sentence(
    composed: Compose, overrides: list[str], message: str
) -> None:
    with pytest.raises(ConfigError) as error:
        composed(overrides)
    sentences = str(error.value).splitlines()
    assert message in sentences[0]
    assert len(sentences) == 1 or "strategy.name=none" in sentences[1]


@pytest.mark.parametrize(
    "overrides",
    [
        ["runtime.name=deployment", "rooms.count=2", "federation.on_loss=miss"],
        ["rooms.count=3", "rooms.strategy.name=krum"],
        ["rooms.count=2", "rooms.strategy.name=fedavgm", "rooms.strategy.momentum=0.5"],
        ["rooms.count=3", "federation.clients=3", "env.robots=2"],
    ],
)
def test_what_goes_in_a_building_is_taken(composed: Compose, overrides: list[str]) -> None:
    assert composed(overrides).rooms.count > 1


def test_rooms_are_dealt_to_four_clients_at_most_unless_more_are_asked_for(
    tiny_building: Building,
) -> None:
    for count, clients, expected in ((3, None, 3), (40, None, 4), (40, 9, 9)):
        given_ = {"rooms.count": count, "federation.clients": clients}
        assert flower_clients(tiny_building(given_)) == expected


@pytest.fixture
def refused(building: Building) -> Callable[..., str]:
    """Draws rooms that must be refused; returns what is said."""

    def make(*overrides: str) -> str:
        with pytest.raises(ConfigError) as error:
            rooms_of(building(*overrides))
        [sentence] = str(error.value).splitlines()
        return sentence

    return make


def test_a_plan_that_is_not_there_is_named(refused: Callable[..., str]) -> None:
    assert refused("rooms.plans=[default,nowhere.toml]").startswith(
        "rooms.plans: env.plan=nowhere.toml: allowed is one of corridor, default, hall, "
    )


def test_a_plan_that_is_no_toml_is_named(refused: Callable[..., str], own_plan: Path) -> None:
    own_plan.write_text("[walls")
    assert f"rooms.plans: env.plan={own_plan}: allowed is a TOML file" in refused(
        f"rooms.plans=[{own_plan}]"
    )


def test_the_first_room_that_cannot_be_played_is_named(
    refused: Callable[..., str], own_plan: Path
) -> None:
    own_plan.write_text(TWO_WALLS.replace("[6.0, 9.0, 2.0]", "[60.0, 9.0, 2.0]"))
    found = refused(f"rooms.plans=[default,{own_plan}]")
    assert found.startswith(f"room 0001 ({own_plan}, seed ")
    assert "env.ap.position_m=" in found


def test_robots_that_see_unequally_much_are_refused(refused: Callable[..., str]) -> None:
    found = refused("rooms.robots=[2,4]", "env.state.others=2")
    assert found.startswith("env.state.others=2: allowed is such that robots of all rooms see ")


def test_access_points_of_rooms_with_other_numbers_of_robots_share_no_network(
    building: Building, refused: Callable[..., str]
) -> None:
    unequal = ("rooms.robots=[2,3]", "env.state.others=0")
    mean = "rooms.access_points=mean"
    assert refused(*unequal, mean).startswith("rooms.access_points=mean: allowed is own, where")
    assert len(rooms_of(building(*unequal))) == 4
    assert len(rooms_of(building(*unequal, mean, "scheme.phase=fixed"))) == 4


def test_a_plans_file_is_named_by_its_whole_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.toml").write_text("[walls]\nblock_motion = true\n")
    monkeypatch.chdir(tmp_path)
    config = compose(["rooms.count=2", "rooms.plans=[mine.toml,hall,random]"])
    assert config.rooms.plans == [str(tmp_path / "mine.toml"), "hall", "random"]
    monkeypatch.chdir("/")
    assert len(rooms_of(config)) == 2
