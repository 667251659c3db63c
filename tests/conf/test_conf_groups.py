"""The YAML groups say what the dataclasses say, key by key."""

import dataclasses
import shutil
import sys

import pytest
from omegaconf import OmegaConf

from agent.config import AgentConfig
from conf import Config, ConfigError, StrategyConfig, compose, flower_clients, windows_per_round
from conf.compose import FOLDER
from env import floor_plans
from env.config import EnvConfig


def read(*path):
    return OmegaConf.to_container(OmegaConf.load(FOLDER.joinpath(*path)))


@pytest.mark.parametrize(
    ("file", "schema"),
    [
        ("env/default", EnvConfig()),
        ("agent/dqn", AgentConfig()),
    ],
)
def test_a_group_writes_out_its_schemas_defaults(file, schema):
    written = OmegaConf.create(read(f"{file}.yaml"))
    if "plan" in written:  # which gives the geometry
        written = OmegaConf.merge({key: {} for key in ("room", "walls", "ap", "tasks")}, written)
        plan = OmegaConf.create(floor_plans.read(written.plan))
        both = [key for key in floor_plans.KEYS if OmegaConf.select(written, key) is not None]
        assert not both, "a key stands in the group's file or in the plan, not in both"
        written = OmegaConf.merge(written, plan)
    assert OmegaConf.to_container(written) == dataclasses.asdict(schema)


def test_the_main_file_writes_out_the_schemas_defaults():
    written = read("config.yaml")
    chosen = {key for item in written.pop("defaults") if isinstance(item, dict) for key in item}
    assert chosen == {"env", "agent", "strategy", "runtime", "baseline", "experiment"}
    groups = ("env", "agent", "strategy", "runtime")
    expected = {k: v for k, v in dataclasses.asdict(Config()).items() if k not in groups}
    assert written == expected


@pytest.mark.parametrize("group", ["strategy", "runtime"])
def test_each_choice_has_the_name_of_its_file_and_known_keys(group):
    known = {field.name for field in dataclasses.fields(getattr(Config(), group))}
    files = sorted((FOLDER / group).glob("*.yaml"))
    assert files
    for path in files:
        written = read(group, path.name)
        assert written["name"] == path.stem
        assert set(written) <= known


def test_fedavg_is_the_schemas_default_strategy():
    assert StrategyConfig(**read("strategy", "fedavg.yaml")) == StrategyConfig()


def test_the_papers_table_1_for_agents():
    agent = AgentConfig()
    assert (agent.learning_rate, agent.batch_size) == (1e-4, 128)
    assert Config().federation.every == 25


@pytest.mark.parametrize(("robots", "clients"), [(1, 1), (3, 3), (4, 4), (9, 4)])
def test_by_default_up_to_four_flower_clients_hold_the_robots(robots, clients):
    config = dataclasses.replace(Config(), env=EnvConfig(robots=robots))
    assert flower_clients(config) == clients


def test_clients_and_windows_that_are_given_count():
    federation = dataclasses.replace(Config().federation, clients=2, windows_per_round=1)
    config = dataclasses.replace(Config(), federation=federation)
    assert flower_clients(config) == 2
    assert windows_per_round(config) == 1
    assert windows_per_round(Config()) == 100


OWN = "# @package _global_\nenv:\n  robots: 2\n"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (OWN.encode(), None),
        (OWN.replace("\n", "\r\n").encode(), None),
        (
            OWN.encode("utf-8-sig"),
            "it begins with a byte order mark, which Hydra does not read: save it as UTF-8 without"
            " one",
        ),
        (OWN.encode("utf-16"), "it is in UTF-16: save it as UTF-8"),
    ],
    ids=["plain", "crlf", "mark", "utf-16"],
)
def test_a_groups_file_of_ones_own_is_read_or_named(monkeypatch, tmp_path, content, said):
    folder = shutil.copytree(FOLDER, tmp_path / "conf")
    path = folder / "experiment" / "mine.yaml"
    path.write_bytes(content)
    monkeypatch.setattr(sys.modules["conf.compose"], "FOLDER", folder)
    if said is None:
        assert compose(["experiment=mine"]).env.robots == 2
    else:
        with pytest.raises(ConfigError) as caught:
            compose(["experiment=mine"])
        assert str(caught.value) == f"experiment=mine: {path} cannot be read: {said}."
