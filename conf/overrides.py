"""Hydra overrides: each is parsed once, and checked by itself for its form, key and type."""

from __future__ import annotations

import copy
import dataclasses
import difflib
import itertools
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from conf import own_groups
from conf.errors import ConfigError, shown
from conf.removed_keys import check_removed
from conf.schema import Config
from conf.user_paths import LISTED, PATHS, with_quoted_path
from env.validate import hints_of, refused

FOLDER = Path(__file__).parent
GROUPS = (
    "env",
    "agent",
    "strategy",
    "strategy/dp",
    "attack",
    "runtime",
    "baseline",
    "experiment",
)
PLACES = ("hydra.sweep.dir", "hydra.sweep.subdir", "hydra.run.dir")


def parse(
    texts: Sequence[str], *, sweep: bool = False, launcher: bool = False, sweeper: bool = False
) -> list[Override]:
    """Parses overrides and checks each by itself.

    What an override says is read from what comes back, nowhere from its text: ``input_line`` is
    the text for Hydra, in which paths are quoted.

    Args:
        texts: such as ``env.robots=4``.
        sweep: whether an override may list several values.
        launcher: whether Hydra's launcher may be chosen; beside it and ``hydra.searchpath`` no key
            of Hydra's has an effect.
        sweeper: whether Hydra's sweeper may be, too.

    Raises:
        ConfigError: names the first mistake.
    """
    schema = copy.deepcopy(schema_node())  # values are tried in it
    found = [_parsed(text, with_quoted_path(text, several=sweep)) for text in texts]
    roots = [FOLDER, *own_groups.folders_of(found)]
    for text, override in zip(texts, found, strict=True):
        if is_hydras(override):
            _check_hydras(text, override, launcher=launcher, sweeper=sweeper)
        elif override.key_or_group != own_groups.KEY:
            _check(text, override, schema, roots, sweep=sweep)
    return found


def _parsed(text: str, line: str) -> Override:
    """What Hydra reads in a line that stands for a text of the user's."""
    try:
        return OverridesParser.create().parse_override(line)
    except HydraException as error:
        hint = ": quote a value that holds more than a word" if "=" in text else ""
        raise ConfigError(f"{text!r} is not of the form key=value{hint}.") from error
    except AttributeError as error:  # Hydra reads functions by assertions
        if __debug__:
            raise
        say = "range() and other functions need Python's assertions, which PYTHONOPTIMIZE takes out"
        raise ConfigError(f"{text}: {say}: list the values, as in KEY=A,B,C.") from error


def is_hydras(override: Override) -> bool:
    """Whether a key is Hydra's own and says nothing of a run."""
    if override.key_or_group == own_groups.KEY:
        return False
    return override.key_or_group == "hydra" or override.is_hydra_override()


def lines(overrides: Sequence[Override]) -> list[str]:
    """Overrides as Hydra takes them."""
    return [str(override.input_line) for override in overrides]


def combinations(overrides: Sequence[Override]) -> list[list[str]]:
    """Every combination of the values that overrides list, the last one varying fastest.

    Args:
        overrides: parsed, of a run's keys.

    Raises:
        ConfigError: values that cannot be listed, such as an interval.
    """
    axes = []
    for override in overrides:
        key = override.get_key_element()
        try:
            values = (
                list(override.sweep_string_iterator())
                if override.is_sweep_override()
                else [override.get_value_element_as_str()]
            )
        except HydraException as error:
            say = "allowed in a sweep are values, as in KEY=A,B,C, or range(...)"
            raise ConfigError(f"{override.input_line}: {say}.") from error
        axes.append([f"{key}={value}" for value in values])
    return [list(combination) for combination in itertools.product(*axes)]


@cache
def schema_node() -> DictConfig:
    """The schema as a node that copies of can be merged into; one for all, to be read alone."""
    node: DictConfig = OmegaConf.structured(Config)
    _set_writable(node)  # frozen dataclasses make it read-only
    return node


def _set_writable(node: Any) -> None:
    if isinstance(node, DictConfig):
        OmegaConf.set_readonly(node, None)
        for key in node:
            _set_writable(node._get_node(key))


def _check_hydras(text: str, override: Override, *, launcher: bool, sweeper: bool) -> None:
    key = override.key_or_group
    if key in PLACES:
        say = "run.dir=FOLDER, which a sweep's runs lie in" if launcher else "run.dir=FOLDER"
        raise ConfigError(f"{text.lstrip('+')}: allowed is {say}.")
    if not launcher:
        raise ConfigError(f"{text}: allowed are keys of a run: Hydra's own have no effect here.")
    plugins = ("launcher", "sweeper") if sweeper else ("launcher",)
    if not re.fullmatch(
        rf"hydra/({'|'.join(plugins)})(/\w+)?|hydra\.({'|'.join(plugins)})\..+", key
    ):
        names = " and ".join(f"hydra/{name}=NAME and hydra.{name}.KEY" for name in plugins)
        raise ConfigError(
            f"{text}: allowed of Hydra's own keys are {names}: no other has an effect here."
        )
    if override.is_sweep_override():
        raise ConfigError(f"{text}: allowed is one {' or '.join(plugins)} for all runs.")


def _check(
    text: str, override: Override, schema: DictConfig, roots: Sequence[Path], *, sweep: bool
) -> None:
    key = override.key_or_group
    if not key:
        raise ConfigError(f"{text!r} is not of the form key=value.")
    several = override.is_sweep_override() or _lists_paths(override)
    if several and not sweep:
        raise ConfigError(f"{text!r} lists several values: allowed is one, or a sweep with -m.")
    if override.is_delete() or (override.is_add() and not override.is_force_add()):
        raise ConfigError(f"{text!r}: keys can be neither added nor deleted, only set: key=value.")
    if key in GROUPS:
        own_groups.check_choice(override, roots)
    elif override.is_sweep_override():
        check_key(key)
    else:
        _check_value(key, override, schema)


def _lists_paths(override: Override) -> bool:
    """Whether a path that is no file's lists floor plans, or files of channels."""
    if override.key_or_group not in LISTED:
        return False
    value = str(override.value())
    return "," in value and not Path(value).exists()


def check_key(key: str) -> Any:
    """The default value at a key.

    Raises:
        ConfigError: there is no such key.
    """
    value: Any = Config()
    for depth, name in enumerate(parts := key.split(".")):
        names = (
            [f.name for f in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else []
        )
        if name not in names:
            check_removed(key)
            above = ".".join(parts[:depth])
            raise ConfigError(_unknown_key(key, [f"{above}.{n}" if above else n for n in names]))
        value = getattr(value, name)
    return value


def _check_value(key: str, override: Override, schema: DictConfig) -> None:
    default = check_key(key)
    if dataclasses.is_dataclass(default):
        raise ConfigError(
            f"{key} is a group of keys: set one of them, such as "
            f"{key}.{dataclasses.fields(default)[0].name}."
        )
    if key in PATHS and override.value() == "":
        raise ConfigError.of([(key, "", "a path")])
    value, hint = override.value(), hint_of(key)
    try:
        OmegaConf.update(schema, key, value)
    except OmegaConfBaseException as error:
        kind = refused(value, hint)
        if isinstance(default, list):
            kind = f"a list such as {shown(default)}"
        raise ConfigError.of([(key, value, kind)]) from error
    if value == "???":  # to OmegaConf a value that is still to come
        raise ConfigError.of([(key, value, refused(value, hint) or "a value")])


def hint_of(key: str) -> Any:
    """The annotation of a key's field.

    Raises:
        ConfigError: there is no such key.
    """
    check_key(key)
    *above, name = key.split(".")
    group: type = type(check_key(".".join(above)) if above else Config())
    return hints_of(group)[name]


def _unknown_key(key: str, siblings: Sequence[str]) -> str:
    every = [*all_keys(), *GROUPS]
    close = difflib.get_close_matches(key, every, n=3, cutoff=0.6)
    if close:
        return f"{key} is no key: did you mean {' or '.join(close)}?"
    return f"{key} is no key: allowed here are {', '.join(siblings) or 'no further keys'}."


def all_keys() -> list[str]:
    """Every key of a run."""
    return _all_keys(Config())


def _all_keys(value: Any, above: str = "") -> list[str]:
    keys: list[str] = []
    for item in dataclasses.fields(value):
        inner, key = getattr(value, item.name), f"{above}{item.name}"
        keys += _all_keys(inner, f"{key}.") if dataclasses.is_dataclass(inner) else [key]
    return keys
