"""Hydra overrides: each is parsed once, and checked by itself for its form, key and type."""

from __future__ import annotations

import copy
import dataclasses
import difflib
import itertools
import re
from collections.abc import Iterator, Sequence
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

    Of what comes back, ``input_line`` is the text for Hydra, in which paths are quoted.

    Args:
        texts: such as ``env.robots=4``.
        sweep: whether an override may list several values.
        launcher: whether Hydra's launcher may be chosen; beside it and ``hydra.searchpath`` no key
            of Hydra's has an effect.
        sweeper: whether Hydra's sweeper may be, too.

    Raises:
        ConfigError: names the first mistake.
    """
    found = [_parsed(text, with_quoted_path(text, several=sweep)) for text in texts]
    roots = [FOLDER, *own_groups.folders_of(found)]
    for text, override in zip(texts, found, strict=True):
        if is_hydras(override):
            _check_hydras(text, override, launcher=launcher, sweeper=sweeper)
        elif override.key_or_group != own_groups.KEY:
            _check(text, override, roots, sweep=sweep)
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
    """Every combination of the values that overrides of keys list, the last varying fastest.

    Raises:
        ConfigError: values that cannot be listed, such as an interval.
    """
    axes = []
    for override in overrides:
        if not override.is_sweep_override():
            values = [override.get_value_element_as_str()]
        else:
            try:
                values = list(override.sweep_string_iterator())
            except HydraException as error:
                say = "allowed in a sweep are values, as in KEY=A,B,C, or range(...)"
                raise ConfigError(f"{override.input_line}: {say}.") from error
        axes.append([f"{override.get_key_element()}={value}" for value in values])
    return [list(combination) for combination in itertools.product(*axes)]


@cache
def schema_node() -> DictConfig:
    """The schema, to be read and merged alone; frozen dataclasses would make it read-only."""
    node: DictConfig = OmegaConf.structured(Config)
    groups: list[Any] = [node]
    for group in groups:
        OmegaConf.set_readonly(group, None)
        found = [group._get_node(key) for key in group]
        groups += [each for each in found if isinstance(each, DictConfig)]
    return node


@cache
def _trial() -> DictConfig:
    """The schema once more, in which values are tried."""
    return copy.deepcopy(schema_node())


def node_of(config: Config) -> DictConfig:
    """A configuration as a typed node that can be written to."""
    node = copy.deepcopy(schema_node())
    for key, (value, _) in _walk(config, ""):
        if not dataclasses.is_dataclass(value) and value != _fields()[key][0]:
            OmegaConf.update(node, key, value)
    return node


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


def _check(text: str, override: Override, roots: Sequence[Path], *, sweep: bool) -> None:
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
        _field(key)
    else:
        _check_value(key, override)


def _lists_paths(override: Override) -> bool:
    """Whether a path that is no file's lists floor plans, or files of channels."""
    if override.key_or_group not in LISTED:
        return False
    value = str(override.value())
    return "," in value and not Path(value).exists()


@cache
def _fields() -> dict[str, tuple[Any, Any]]:
    """Each key, and each group of keys, with its default and its annotation."""
    return dict(_walk(Config(), ""))


def _walk(group: Any, above: str) -> Iterator[tuple[str, tuple[Any, Any]]]:
    for name, hint in hints_of(group.__class__).items():
        value = getattr(group, name)
        yield above + name, (value, hint)
        if dataclasses.is_dataclass(value):
            yield from _walk(value, f"{above}{name}.")


def _field(key: str) -> tuple[Any, Any]:
    """The default and the annotation of a key.

    Raises:
        ConfigError: there is no such key.
    """
    if key in _fields():
        return _fields()[key]
    check_removed(key)
    if close := difflib.get_close_matches(key, [*all_keys(), *GROUPS], n=3, cutoff=0.6):
        raise ConfigError(f"{key} is no key: did you mean {' or '.join(close)}?")
    above = key
    while above and above not in _fields():
        above = above.rpartition(".")[0]
    siblings = ", ".join(each for each in _fields() if each.rpartition(".")[0] == above)
    raise ConfigError(f"{key} is no key: allowed here are {siblings or 'no further keys'}.")


def hint_of(key: str) -> Any:
    """The annotation of a key's field; a ConfigError where there is none."""
    return _field(key)[1]


def all_keys() -> list[str]:
    """Every key of a run."""
    return [key for key, (value, _) in _fields().items() if not dataclasses.is_dataclass(value)]


def _check_value(key: str, override: Override) -> None:
    (default, hint), value = _field(key), override.value()
    if dataclasses.is_dataclass(default):
        first = f"{key}.{dataclasses.fields(default)[0].name}"
        raise ConfigError(f"{key} is a group of keys: set one of them, such as {first}.")
    if key in PATHS and value == "":
        raise ConfigError.of([(key, "", "a path")])
    try:
        OmegaConf.update(_trial(), key, value, merge=False)  # whatever was tried before
    except OmegaConfBaseException as error:
        kind = f"a list such as {shown(default)}" if isinstance(default, list) else ""
        raise ConfigError.of([(key, value, kind or refused(value, hint))]) from error
    if value == "???":  # to OmegaConf a value that is still to come
        raise ConfigError.of([(key, value, refused(value, hint) or "a value")])
