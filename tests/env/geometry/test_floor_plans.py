"""Floor plans: the built-in ones, a user's own, and what wins over them."""

import dataclasses
import re
import shutil
import sys
import tomllib

import numpy as np
import pytest

from conf import Config, ConfigError, compose, from_yaml, to_yaml
from conf.overrides import FOLDER
from env.apis.parallel_env import RISFleetParallelEnv
from env.apis.single_robot import SingleRobotEnv
from env.checks import checked_config
from env.config import EnvConfig
from env.config_checks import problems
from env.geometry import floor_plans
from env.geometry.floor import Floor
from env.radio.radio_map import build_radio_map
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World
from experiments.cli import main
from server_app.app import _asked as asked_on_flower

NAMES = ["corridor", "default", "hall"]
NEW = ["corridor", "hall"]
OWN = """
[room]
width_m = 12
depth_m = 9.0

[ap]
position_m = [6, 9, 2]

[ris]
position_m = [12, 4, 2]

[tasks]
destinations_m = [[1.25, 1.25], [10.25, 1.25], [6.25, 7.25]]
start_distance_m = 2
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """The working folder holds a plan of the user's."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plans").mkdir()
    path = tmp_path / "plans" / "mine.toml"
    path.write_text(OWN)
    return path


def test_the_built_in_plans():
    assert floor_plans.built_in() == NAMES


def test_the_default_plan_is_the_defaults_key_by_key():
    assert checked_config({"plan": "default"}) == EnvConfig() == checked_config()
    values = floor_plans.read("default")
    whole = dataclasses.asdict(EnvConfig())
    for key in floor_plans.KEYS:
        group, name = key.split(".")
        assert values[group][name] == whole[group][name]


@pytest.mark.parametrize("name", NEW)
def test_a_new_plan_changes_the_geometry_alone(name):
    found, default = checked_config({"plan": name}), EnvConfig()
    groups = {key.split(".")[0] for key in floor_plans.KEYS}
    for item in dataclasses.fields(EnvConfig):
        if item.name not in (*groups, "plan"):
            assert getattr(found, item.name) == getattr(default, item.name)
    assert found.plan == name
    assert found.walls.block_motion
    assert found.ris.side == default.ris.side


@pytest.mark.parametrize("name", NEW)
@pytest.mark.parametrize("robots", [1, 4, 6])
def test_robots_of_a_new_plan_have_ways_that_they_can_drive_in_time(name, robots):
    config = checked_config({"plan": name, "robots": robots, "collisions": "block"})
    world = World(Scenario.drawn(config, 0), stream(0, Stream.WORLD), worlds=500)
    world.reset()
    assert world.shortest_slots.max() < config.motion.max_slots
    drivable = world.floor.drivable()
    assert world.slots_to_go[drivable].max() < config.motion.max_slots


@pytest.mark.parametrize(("name", "shadow"), [("corridor", 0.75), ("hall", 0.3)])
def test_a_new_plan_has_shadow_in_which_the_surface_helps(name, shadow):
    config = checked_config({"plan": name})
    radio_map, floor = build_radio_map(config), Floor.from_config(config)
    dark = ~radio_map.direct_los & floor.drivable()
    assert dark.sum() > shadow * floor.drivable().sum()
    best = np.abs(radio_map.direct[:, None] + radio_map.reflected @ radio_map.settings.T).max(-1)
    gain_db = 20 * np.log10(best / np.abs(radio_map.direct))
    assert gain_db[dark].mean() > 10


def test_the_rooms_of_the_corridor_lie_in_the_access_points_shadow():
    config = checked_config({"plan": "corridor"})
    rooms = Floor.from_config(config).centres()[:, 1] < 14.0
    lit = build_radio_map(config).direct_los & rooms
    assert lit.sum() < 0.02 * rooms.sum()


@pytest.mark.parametrize("name", NEW)
def test_the_views_and_the_command_have_the_same_plan(name):
    composed = compose([f"env.plan={name}", "env.robots=2"]).env
    assert composed == checked_config({"plan": name, "robots": 2})
    assert asked_on_flower([f"env.plan={name}", "env.robots=2"])[0].env == composed
    if name == "corridor":  # the views make their worlds, which takes longer
        assert RISFleetParallelEnv({"plan": name, "robots": 2}).config == composed
        assert SingleRobotEnv({"plan": name, "robots": 2}).config == composed


# What wins.


@pytest.mark.parametrize("order", [1, -1])
def test_an_override_wins_over_the_plan_even_where_it_sets_the_default(order):
    overrides = ["env.plan=corridor", "env.walls.block_motion=false", "env.room.width_m=40"]
    found = compose(overrides[::order]).env
    assert not found.walls.block_motion
    assert (found.room.width_m, found.room.depth_m) == (40.0, 18.0)
    nested = {"plan": "corridor", "walls": {"block_motion": False}, "room": {"width_m": 40.0}}
    assert checked_config(nested) == found


def test_an_experiment_wins_over_the_plan(monkeypatch, tmp_path):
    folder = shutil.copytree(FOLDER, tmp_path / "conf")
    (folder / "experiment" / "office.yaml").write_text(
        "# @package _global_\nenv:\n  plan: corridor\n  motion:\n    max_slots: 99\n"
    )
    for module in ("conf.compose", "conf.overrides"):
        monkeypatch.setattr(sys.modules[module], "FOLDER", folder)
    found = compose(["experiment=office"]).env
    assert (found.plan, found.room.depth_m, found.motion.max_slots) == ("corridor", 18.0, 99)


@pytest.mark.parametrize("slots", [EnvConfig().motion.max_slots, 151])
def test_what_a_user_wrote_is_above_the_plan_whatever_the_default(monkeypatch, tmp_path, slots):
    folder = shutil.copytree(FOLDER, tmp_path / "conf")
    (folder / "experiment" / "office.yaml").write_text(
        f"# @package _global_\nenv:\n  motion:\n    max_slots: {slots}\n"
    )
    for module in ("conf.compose", "conf.overrides"):
        monkeypatch.setattr(sys.modules[module], "FOLDER", folder)
    assert compose(["experiment=office", "env.plan=hall"]).env.motion.max_slots == slots
    assert compose([f"env.motion.max_slots={slots}", "env.plan=hall"]).env.motion.max_slots == slots


def test_a_plan_wins_over_the_defaults():
    assert compose(["env.plan=hall"]).env.motion.max_slots == 200


def test_a_configuration_that_is_written_out_needs_its_plan_no_more(own):
    config = compose(["env.plan=plans/mine.toml", "runtime=local"])
    text = to_yaml(config)
    own.unlink()
    again = from_yaml(text)
    assert again == config
    assert (again.env.plan, again.env.room.width_m) == ("plans/mine.toml", 12.0)
    assert config_on_flower_from(text, own.parent) == again.env


def config_on_flower_from(text, folder):
    return asked_on_flower([text.replace("name: local", "name: simulation")])[0].env


def test_a_plan_that_changes_later_changes_nothing_that_is_written_out(own):
    text = to_yaml(compose(["env.plan=plans/mine.toml"]))
    own.write_text(OWN.replace("start_distance_m = 2", "start_distance_m = 3"))
    assert from_yaml(text).env.tasks.start_distance_m == 2.0


# A user's own.


def test_a_plan_may_leave_keys_out_and_write_whole_numbers(own):
    found = compose(["env.plan=plans/mine.toml"]).env
    assert (found.room.width_m, found.room.depth_m, found.room.cell_m) == (12.0, 9.0, 0.5)
    assert found.motion == EnvConfig().motion
    assert checked_config({"plan": "plans/mine.toml"}) == found
    assert checked_config({"plan": str(own)}).room == found.room


def test_a_built_in_name_wins_over_a_file_of_that_name(own):
    (own.parent.parent / "hall").write_text(OWN)
    assert checked_config({"plan": "hall"}).room.width_m == 40.0


MISTAKES = [
    ("[room\n", "allowed is a TOML file (Expected ']'"),
    ("[room]\nwidth = 3\n", "room.width=3: allowed keys are room.width_m, room.depth_m, "),
    ("robots = 4\n", "robots=4: allowed keys are room.width_m, "),
    ("[ris]\nside = 4\n", "ris.side=4: allowed keys are "),
    ("[reward]\ndistance = 'way'\n", "reward.distance=way: allowed keys are "),
    ("[extra]\n", "extra={}: allowed keys are "),
    ("room = 3\n", "room=3: allowed keys are "),
    ("[room.width_m]\nm = 3\n", "room.width_m.m=3: allowed keys are "),
    ("[room]\nwidth_m = 'wide'\n", "env.room.width_m='wide': allowed is a number"),
    ("[motion]\nmax_slots = 1.5\n", "env.motion.max_slots=1.5: allowed is a whole number"),
    ("[walls]\nblock_motion = 1\n", "env.walls.block_motion=1: allowed is true or false"),
    ("[walls]\nsegments = 1\n", "env.walls.segments=1: allowed is a list"),
    ("[ris]\naxis = 1\n", "env.ris.axis=1: allowed is a word"),
]


@pytest.mark.parametrize(("text", "part"), MISTAKES, ids=lambda x: x.split("\n")[0])
def test_a_mistake_in_a_plan_names_file_key_and_what_is_allowed(own, capsys, text, part):
    own.write_text(text)
    with pytest.raises(ConfigError) as caught:
        compose(["env.plan=plans/mine.toml"])
    said = str(caught.value)
    assert said.startswith("env.plan=plans/mine.toml: ")
    assert part in said
    assert said.endswith(".")
    with pytest.raises(ValueError, match=r"plans/mine\.toml") as caught:
        checked_config({"plan": "plans/mine.toml"})
    assert f"{caught.value}." == said
    assert main(["train", "runtime=local", "env.plan=plans/mine.toml"]) == 2
    assert capsys.readouterr().err == f"risfleet: {said}\n"


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("[ap]\nposition_m = [1, 2]\n", "env.ap.position_m=[1.0,2.0]: allowed is [x, y, z] in m"),
        ("[walls]\nsegments = [[0, 0]]\n", "env.walls.segments=[0,0]: allowed is segments"),
        ("[ris]\naxis = 'z'\n", "env.plan=plans/mine.toml: env.ris.axis='z': allowed is x or y"),
    ],
)
def test_a_wrong_value_in_a_plan_is_named_as_anywhere_else(own, text, part):
    own.write_text(text)
    with pytest.raises(ConfigError) as caught:
        compose(["env.plan=plans/mine.toml"])
    assert str(caught.value).startswith(part)


@pytest.mark.parametrize("name", ["corridr", "plans/none.toml", "plans", "12"])
def test_a_plan_that_does_not_exist_is_named_with_those_that_do(own, name):
    names = "corridor, default, hall, random:SEED"
    allowed = f"allowed is one of {names}, or the path of a TOML file that exists."
    with pytest.raises(ConfigError) as caught:
        compose([f"env.plan={name}"])
    assert str(caught.value) == f"env.plan={name}: {allowed}"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_plan_may_come_from_any_editor(own, encoding, end):
    plain = checked_config({"plan": "plans/mine.toml"})
    own.write_bytes(f"# Größe{OWN}".replace("\n", end).encode(encoding))
    assert checked_config({"plan": "plans/mine.toml"}) == plain


@pytest.mark.parametrize(
    ("encoding", "said"),
    [
        ("utf-16", "it is in UTF-16: save it as UTF-8"),
        ("latin-1", "line 1 holds the byte 0xf6, which is not UTF-8: save it as UTF-8"),
    ],
)
def test_a_plan_in_another_encoding_is_refused_with_what_to_do(own, encoding, said):
    own.write_bytes(f"# Größe{OWN}".encode(encoding))
    with pytest.raises(ConfigError) as caught:
        compose(["env.plan=plans/mine.toml"])
    assert str(caught.value) == f"env.plan=plans/mine.toml: allowed is a TOML file ({said})."


def test_a_plan_that_is_no_word_is_refused():
    with pytest.raises(ValueError, match=r"env\.plan=3: allowed is a word"):
        checked_config({"plan": 3})


def test_a_plans_name_in_a_whole_configuration_reads_nothing():
    config = dataclasses.replace(EnvConfig(), plan="gone.toml")
    assert checked_config(config) is config
    assert problems(config) == []
    assert from_yaml(to_yaml(dataclasses.replace(Config(), env=config))).env == config


def test_every_key_of_every_built_in_plan_is_one_that_a_plan_may_set():
    for name in NAMES:
        values = tomllib.loads(floor_plans.find(name).read_text())
        keys = {f"{group}.{key}" for group, inner in values.items() for key in inner}
        assert keys == {*floor_plans.KEYS}


# The document.


def blocks(language):
    text = (FOLDER.parent / "docs" / "floor_plans.md").read_text()
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def test_the_documents_example_is_a_plan_that_trains(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    [text] = blocks("toml")
    (tmp_path / "two_rooms.toml").write_text(text)
    config = compose(["env.plan=two_rooms.toml"]).env
    floor = Floor.from_config(config)
    assert floor.drivable().all()
    through_the_door = floor.cell_at(np.array([6.25, 1.25])), floor.cell_at(np.array([1.25, 1.25]))
    there = floor.slots_to(np.array([through_the_door[0]]))[through_the_door[1], 0]
    assert there == 10 + 2 * 2  # ten cells across, and up to the door and down again
    limits = ["train.max_ticks=5", "evaluation.episodes=1", "run.figures=false"]
    command = ["train", "runtime=local", "env.plan=two_rooms.toml"]
    assert main([*command, *limits, "run.tensorboard=false", "run.dir=run"]) == 0
    assert from_yaml((tmp_path / "run" / "config.yaml").read_text()).env.plan == "two_rooms.toml"


def test_the_documents_script_draws_the_pictures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs" / "images").mkdir(parents=True)
    script = FOLDER.parent / "docs" / "examples" / "floor_plan_pictures.py"
    exec(script.read_text(), {})
    drawn = sorted(path.name for path in (tmp_path / "docs" / "images").glob("*.png"))
    assert drawn == ["plan_corridor.png", "plan_hall.png"]


def test_the_document_names_every_plan_and_key():
    text = (FOLDER.parent / "docs" / "floor_plans.md").read_text()
    named = {*re.findall(r"`([\w.*]+)`", text)}
    assert {*NAMES} <= named
    assert {key for key in floor_plans.KEYS if not key.startswith("tasks.")} <= named


def test_the_plans_content_is_part_of_the_fingerprint(monkeypatch, tmp_path):
    module = sys.modules["conf.fingerprint"]
    shutil.copytree(floor_plans.FOLDER, tmp_path / "env" / "geometry" / "plans")
    monkeypatch.setattr(module, "__file__", str(tmp_path / "conf" / "fingerprint.py"))
    before = module._content()
    with (tmp_path / "env" / "geometry" / "plans" / "hall.toml").open("a") as file:
        file.write("# changed\n")
    assert module._content() != before
