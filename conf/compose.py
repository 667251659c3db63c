"""From Hydra overrides to a checked configuration, with one clear sentence for each mistake."""

from __future__ import annotations

import copy
import dataclasses
import difflib
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError  # type: ignore[import-untyped]

from conf.checks import problems
from conf.schema import Config
from env.checks import planned_config
from env.config import EnvConfig, Problem
from env.floor_plans import KEYS as PLAN_KEYS
from env.texts import read_unmarked_text

FOLDER = Path(__file__).parent
GROUPS = ("env", "agent", "strategy", "runtime", "baseline", "experiment")


class ConfigError(ValueError):
    """A mistake of the user's: the message names the key, the value and what is allowed."""

    @classmethod
    def of(cls, found: Sequence[Problem]) -> ConfigError:
        """The error for a list of problems, a sentence each."""
        return cls(
            "\n".join(f"{key}={_shown(value)}: allowed is {say}." for key, value, say in found)
        )


def register_schema() -> None:
    """Makes the dataclasses known to Hydra as the node ``schema``; safe to call again."""
    ConfigStore.instance().store(name="schema", node=_schema_node())


def _schema_node() -> DictConfig:
    """The schema as a node that can still be merged into: frozen dataclasses make it read-only."""
    node: DictConfig = OmegaConf.structured(Config)
    _set_writable(node)
    return node


def _set_writable(node: Any) -> None:
    if isinstance(node, DictConfig):
        OmegaConf.set_readonly(node, None)
        for key in node:
            _set_writable(node._get_node(key))


def compose(overrides: Sequence[str] = ()) -> Config:
    """Builds the configuration that Hydra overrides describe.

    Args:
        overrides: such as ``env.robots=4`` or ``strategy=krum``.

    Returns:
        The configuration, checked.

    Raises:
        ConfigError: a wrong key, value or combination.
    """
    check_overrides(overrides)
    register_schema()
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(FOLDER), version_base="1.3", job_name="risfleet"):
        try:
            node = hydra_compose("config", overrides=list(overrides))
        except (HydraException, OmegaConfBaseException) as error:
            raise ConfigError(_first_sentence(error)) from error
    return from_composed(node, overrides)


def from_composed(node: DictConfig, overrides: Sequence[str]) -> Config:
    """Turns what Hydra composed into a checked configuration, the floor plan's values included.

    Args:
        node: the composed node.
        overrides: those that it was composed with.

    Raises:
        ConfigError: a wrong plan, value or combination.
    """
    given = {OverridesParser.create().parse_override(text).key_or_group for text in overrides}
    try:
        planned = planned_config(node.env.plan)
        node = copy.deepcopy(node)
        for key in (f"env.{name}" for name in PLAN_KEYS):
            # What an override, a group's file or an experiment changed is above the plan.
            if key not in given and OmegaConf.select(node, key) == _check_key(key):
                OmegaConf.update(node, key, _value_at(planned, key))
    except OmegaConfBaseException as error:
        raise ConfigError(_first_sentence(error)) from error
    except ValueError as error:
        raise ConfigError(f"{error}.") from error
    return from_node(node)


def _value_at(env: EnvConfig, key: str) -> Any:
    value: Any = env
    for name in key.split(".")[1:]:
        value = getattr(value, name)
    return value


def from_node(node: DictConfig) -> Config:
    """Turns a composed node into a checked configuration.

    Raises:
        ConfigError: a wrong value or combination.
    """
    try:
        values = OmegaConf.to_container(node, resolve=True, throw_on_missing=True)
        config = OmegaConf.to_object(OmegaConf.merge(_schema_node(), values))
    except OmegaConfBaseException as error:
        raise ConfigError(_first_sentence(error)) from error
    assert isinstance(config, Config)
    found = problems(config)
    if found:
        raise ConfigError.of(found)
    return config


def overridden(config: Config, overrides: Sequence[str]) -> Config:
    """A configuration with some values set anew, checked.

    Raises:
        ConfigError: a wrong key, value or combination.
    """
    check_overrides(overrides)
    node = OmegaConf.create(to_yaml(config))
    for override in OverridesParser.create().parse_overrides(list(overrides)):
        OmegaConf.update(node, override.key_or_group, override.value())
    assert isinstance(node, DictConfig)
    return from_node(node)


def to_yaml(config: Config) -> str:
    """The whole configuration as YAML."""
    return OmegaConf.to_yaml(OmegaConf.structured(config))


@lru_cache(maxsize=8)
def from_yaml(text: str) -> Config:
    """Reads what ``to_yaml`` wrote.

    Raises:
        ConfigError: it does not fit this version's schema.
    """
    try:
        node = OmegaConf.create(text)
    except (YAMLError, OmegaConfBaseException, AssertionError) as error:  # the last: "12"
        raise ConfigError(f"the configuration is no YAML: {_first_sentence(error)}.") from error
    if not isinstance(node, DictConfig):
        raise ConfigError("the configuration is no mapping of keys to values.")
    return from_node(node)


def check_overrides(overrides: Sequence[str], *, sweep: bool = False) -> None:
    """Checks each override by itself: its form, its key, and its value's type.

    Args:
        overrides: such as ``env.robots=4``.
        sweep: whether an override may list several values.

    Raises:
        ConfigError: names the first mistake.
    """
    schema = _schema_node()
    for text in overrides:
        try:
            override = OverridesParser.create().parse_override(text)
        except HydraException as error:
            hint = ": quote a value that holds more than a word" if "=" in text else ""
            raise ConfigError(f"{text!r} is not of the form key=value{hint}.") from error
        key = override.key_or_group
        if key.startswith("hydra"):
            continue
        if not key:
            raise ConfigError(f"{text!r} is not of the form key=value.")
        if override.is_sweep_override() and not sweep:
            raise ConfigError(f"{text!r} lists several values: allowed is one, or a sweep with -m.")
        if override.is_delete() or (override.is_add() and not override.is_force_add()):
            raise ConfigError(
                f"{text!r}: keys can be neither added nor deleted, only set: key=value."
            )
        if key in GROUPS:
            _check_choice(key, override)
        elif override.is_sweep_override():
            _check_key(key)
        else:
            _check_value(key, override, schema)


def _check_choice(group: str, override: Override) -> None:
    choices = sorted(path.stem for path in (FOLDER / group).glob("*.yaml"))
    values = list(override.sweep_string_iterator()) if override.is_sweep_override() else None
    for value in values or [str(override.value())]:
        if value not in choices:
            raise ConfigError.of([(group, value, f"one of {', '.join(choices)}")])
        path = FOLDER / group / f"{value}.yaml"
        try:
            read_unmarked_text(path, "Hydra")
        except (OSError, UnicodeError) as error:
            raise ConfigError(f"{group}={value}: {path} cannot be read: {error}.") from error


def _check_key(key: str) -> Any:
    """The default value at a key."""
    value: Any = Config()
    for depth, name in enumerate(parts := key.split(".")):
        names = (
            [f.name for f in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else []
        )
        if name not in names:
            above = ".".join(parts[:depth])
            raise ConfigError(_unknown_key(key, [f"{above}.{n}" if above else n for n in names]))
        value = getattr(value, name)
    return value


def _check_value(key: str, override: Override, schema: DictConfig) -> None:
    default = _check_key(key)
    if dataclasses.is_dataclass(default):
        raise ConfigError(
            f"{key} is a group of keys: set one of them, such as "
            f"{key}.{dataclasses.fields(default)[0].name}."
        )
    try:
        OmegaConf.update(schema, key, override.value())
    except OmegaConfBaseException as error:
        if default is None:
            kind = "a whole number" if "int" in _first_sentence(error).lower() else "a value"
            kind += " or null"
        else:
            kind = _KINDS.get(type(default)) or f"a list such as {_shown(default)}"
        raise ConfigError.of([(key, override.value(), kind)]) from error


_KINDS = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a name",
}


def _unknown_key(key: str, siblings: Sequence[str]) -> str:
    every = [*_all_keys(Config()), *GROUPS]
    close = difflib.get_close_matches(key, every, n=3, cutoff=0.6)
    if close:
        return f"{key} is no key: did you mean {' or '.join(close)}?"
    return f"{key} is no key: allowed here are {', '.join(siblings) or 'no further keys'}."


def _all_keys(value: Any, above: str = "") -> list[str]:
    keys: list[str] = []
    for item in dataclasses.fields(value):
        inner, key = getattr(value, item.name), f"{above}{item.name}"
        keys += _all_keys(inner, f"{key}.") if dataclasses.is_dataclass(inner) else [key]
    return keys


def _shown(value: Any) -> str:
    return "null" if value is None else str(value).replace(", ", ",")


def _first_sentence(error: Exception) -> str:
    return str(error).strip().splitlines()[0]
