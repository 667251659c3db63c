"""From Hydra overrides to a checked configuration, with one clear sentence for each mistake."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml  # type: ignore[import-untyped]
from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from conf import own_groups
from conf.checks import problems
from conf.errors import ConfigError, first_sentence, sentence
from conf.overrides import FOLDER, lines, node_of, parse, schema_node
from conf.own_groups import located_plan
from conf.removed_keys import drop_removed
from conf.schema import Config
from conf.user_paths import CHANNELS, PATHS
from env.checks import planned_config
from env.geometry import floor_plans
from env.radio.channel_file import sha256_of
from env.validate import comments

PLAN = "env.plan"

_HYDRAS = ("help", "hydra_help", "hydra_logging", "job_logging", "launcher", "output", "sweeper")
"""Hydra's own groups: nothing of them is wanted here, and they take a tenth of the time."""


def register_schema(plan: str = floor_plans.DEFAULT) -> None:
    """Makes known to Hydra what all groups lie on; safe to call again.

    The node ``schema`` holds the dataclasses' defaults, and ``plan``, on top of it, what a floor
    plan, named or by its path, sets. All that a user writes is above both.

    Raises:
        ConfigError: there is no such plan, or it sets what it may not.
    """
    try:
        planned_config(plan)  # checks keys and types
        values = floor_plans.read(plan)
    except ValueError as error:
        raise ConfigError(f"{error}.") from error
    store = ConfigStore.instance()
    if "schema.yaml" not in store.list(""):  # a copy is made of it
        store.store(name="schema", node=schema_node())
    store.store(name="plan", node={"env": values})


def compose(overrides: Sequence[str] = ()) -> Config:
    """The checked configuration that Hydra overrides such as ``env.robots=4`` describe.

    Raises:
        ConfigError: a wrong key, value or combination.
    """
    parsed = parse(overrides)
    folders = own_groups.folders_of(parsed)
    given = lines([each for each in parsed if each.key_or_group != own_groups.KEY])
    if folders:
        given.append(own_groups.override_of(folders))
    asked = [str(each.value()) for each in parsed if each.key_or_group == PLAN]
    plan = located_plan(asked[-1] if asked else floor_plans.DEFAULT, folders)
    node = _composed_on(plan, given)
    if located_plan(node.env.plan, folders) != plan:  # a group's file names another one
        plan = located_plan(node.env.plan, folders)
        node = _composed_on(plan, given)
    try:
        OmegaConf.update(node, PLAN, plan)
        _find_files(node, folders)
    except OmegaConfBaseException as error:
        raise ConfigError(f"{first_sentence(error)}.") from error
    return _checked(node)


def _find_files(node: DictConfig, folders: Sequence[Path]) -> None:
    """Makes a configuration's paths hold in other working folders, and on without the user's."""
    for key in PATHS:
        if isinstance(path := OmegaConf.select(node, key), str):
            OmegaConf.update(node, key, os.path.expanduser(path))
    plans = [floor_plans.absolute(located_plan(plan, folders)) for plan in node.rooms.plans]
    OmegaConf.update(node, "rooms.plans", plans)
    if isinstance(path := OmegaConf.select(node, CHANNELS), str):
        path = os.path.abspath(own_groups.located(path, folders))
        OmegaConf.update(node, CHANNELS, path)
        if node.env.channel.model == "file" and node.env.channel.sha256 is None:
            node.env.channel.sha256 = sha256_of(path)  # the run's own from now on


def _composed_on(plan: str, overrides: list[str]) -> DictConfig:
    """What Hydra composes on top of a floor plan."""
    register_schema(plan)
    GlobalHydra.instance().clear()
    left_out = [f"~hydra/{group}" for group in _HYDRAS]
    with initialize_config_dir(str(FOLDER), version_base="1.3", job_name="risfleet"):
        try:
            return hydra_compose("config", overrides=[*overrides, *left_out])
        except yaml.YAMLError as error:
            say = " ".join(line.strip() for line in str(error).splitlines())
            raise ConfigError(f"a group's file is no YAML: {say}.") from error
        except (HydraException, OmegaConfBaseException) as error:
            raise ConfigError(sentence(error)) from error


def _checked(node: DictConfig, *, typed: bool = True) -> Config:
    """A node as a checked configuration; stored values, not typed, are put on the schema."""
    try:
        values: Any = node
        if not typed:
            values = OmegaConf.to_container(node, resolve=True, throw_on_missing=True)
            drop_removed(values)
            values = OmegaConf.merge(schema_node(), values)
        config = OmegaConf.to_object(values)
    except OmegaConfBaseException as error:
        raise ConfigError(first_sentence(error)) from error
    assert isinstance(config, Config)
    if found := problems(config):
        raise ConfigError.of(found)
    return config


def overridden(config: Config, overrides: Sequence[str]) -> Config:
    """A configuration with some values set anew, checked.

    Raises:
        ConfigError: a wrong key, value or combination.
    """
    node = node_of(config)
    try:
        for override in parse(overrides):
            OmegaConf.update(node, override.key_or_group, override.value())
    except OmegaConfBaseException as error:
        raise ConfigError(first_sentence(error)) from error
    return _checked(node)


def to_yaml(config: Config) -> str:
    """The whole configuration as YAML."""
    return OmegaConf.to_yaml(node_of(config))


def commented_yaml(config: Config) -> str:
    """The same as people read it: what stands at each field is a comment."""
    return "\n".join(_lines(config, "")) + "\n"


def _lines(config: Any, indent: str) -> Iterator[str]:
    said = comments(config.__class__)
    for item in dataclasses.fields(config):
        value = getattr(config, item.name)
        if dataclasses.is_dataclass(value):
            yield f"{indent}{item.name}:"
            yield from _lines(value, indent + "  ")
        else:
            comment = f" # {said[item.name]}" if said[item.name] else ""
            yield f"{indent}{item.name}: {_value(value)}{comment}"


def _value(value: Any) -> str:
    """A value on one line."""
    text: str = yaml.safe_dump(value, default_flow_style=True, width=float("inf"))
    return text.removesuffix("\n").removesuffix("\n...")


@lru_cache(maxsize=8)
def from_yaml(text: str) -> Config:
    """Reads what ``to_yaml`` wrote, here or in an earlier version.

    Raises:
        ConfigError: it does not fit this version's schema.
    """
    try:
        node: Any = OmegaConf.create(text)
    except AssertionError:  # a number alone
        node = None
    except (yaml.YAMLError, OmegaConfBaseException) as error:
        raise ConfigError(f"the configuration is no YAML: {first_sentence(error)}.") from error
    if not isinstance(node, DictConfig):
        raise ConfigError("the configuration is no mapping of keys to values.")
    return _checked(node, typed=False)
