"""The YAML groups choose and change; defaults stand in the schemas."""

import dataclasses
import shutil
import sys

import pytest
from omegaconf import OmegaConf

from agent.config import AgentConfig
from conf import (
    Config,
    ConfigError,
    StrategyConfig,
    compose,
    flower_clients,
    from_yaml,
    windows_per_round,
)
from conf.compose import commented_yaml
from conf.overrides import FOLDER
from env.checks import planned_config
from env.config import EnvConfig
from env.geometry import floor_plans


def read(*path):
    return OmegaConf.to_container(OmegaConf.load(FOLDER.joinpath(*path)))


def values(node, above=""):
    for name, value in node.items():
        if isinstance(value, dict):
            yield from values(value, f"{above}{name}.")
        else:
            yield f"{above}{name}"


def test_defaults_stand_in_the_schemas_alone():
    chosen = read("config.yaml")
    groups = {key for item in chosen.pop("defaults") if isinstance(item, dict) for key in item}
    assert groups == {
        "env", "agent", "strategy", "strategy/dp", "attack", "runtime", "baseline", "experiment",
    }  # fmt: skip
    assert chosen == {}
    assert read("env", "default.yaml") == read("agent", "dqn.yaml") == {}


def test_the_default_plan_sets_what_a_plan_may_and_says_what_the_schema_says():
    written = floor_plans.read("default")
    assert set(values(written)) == set(floor_plans.KEYS)
    assert dataclasses.asdict(planned_config("default")) == dataclasses.asdict(EnvConfig())


def test_the_commented_configuration_is_the_configuration():
    config = compose(["env.robots=2", "train.max_ticks=9", "env.plan=hall", "strategy=krum",
                      "env.robots=5"])  # fmt: skip
    text = commented_yaml(config)
    assert from_yaml(text) == config
    assert "  robots: 5 # K\n" in text
    assert "fading: static # one of static, none, slot; of the direct channel" in text


@pytest.mark.parametrize("group", ["strategy", "attack", "runtime"])
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
    for module in ("conf.compose", "conf.overrides"):
        monkeypatch.setattr(sys.modules[module], "FOLDER", folder)
    if said is None:
        assert compose(["experiment=mine"]).env.robots == 2
    else:
        with pytest.raises(ConfigError) as caught:
            compose(["experiment=mine"])
        assert str(caught.value) == f"experiment=mine: {path} cannot be read: {said}."
