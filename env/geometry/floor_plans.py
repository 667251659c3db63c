"""Floor plans: built-in ones, the TOML files of ``plans`` here; a user's own; ones from a seed."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import fields
from functools import lru_cache
from pathlib import Path
from typing import Any

from env.config import RoomConfig, TasksConfig, WallsConfig
from env.geometry.random_floors import random_plan
from env.texts import read_text

FOLDER = Path(__file__).parent / "plans"
DEFAULT = "default"
RANDOM = "random"
"""Before a colon and a seed: the plan that is drawn from it."""
KEYS = (
    *(f"room.{item.name}" for item in fields(RoomConfig)),
    *(f"walls.{item.name}" for item in fields(WallsConfig)),
    "ap.position_m",
    "ris.position_m",
    "ris.axis",
    *(f"tasks.{item.name}" for item in fields(TasksConfig)),
    "motion.max_slots",
    "motion.antenna_height_m",
)
"""What a plan may set, without the ``env.`` before it."""
_random_plan = lru_cache(maxsize=1024)(random_plan)  # a building asks for each floor many times


def built_in() -> list[str]:
    """The names of the plans that come along."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def find(name: str) -> Path | int:
    """The file of a plan, or the seed that it is drawn from.

    Args:
        name: of a built-in plan; ``random:SEED``; or the path of a file, from the working folder.

    Raises:
        ValueError: there is no such plan and no such file, or the seed is none.
    """
    word, _, seed = name.partition(":")
    if word == RANDOM:
        if re.fullmatch("[0-9]{1,18}", seed):
            return int(seed)
        allowed = f"{RANDOM}:SEED with a whole number of at most 18 digits, as in {RANDOM}:7"
        raise ValueError(f"env.plan={name}: allowed is {allowed}")
    own = Path(name).expanduser()
    if name in built_in():
        return FOLDER / f"{name}.toml"
    if own.is_file():
        return own
    allowed = (
        f"one of {', '.join(built_in())}, {RANDOM}:SEED, or the path of a TOML file that exists"
    )
    raise ValueError(f"env.plan={name}: allowed is {allowed}")


def absolute(name: Any) -> Any:
    """The name of a plan, whatever the working folder: of a file its whole path."""
    try:
        found = find(name) if isinstance(name, str) and name not in built_in() else None
    except ValueError:
        return name
    return str(found.absolute()) if isinstance(found, Path) else name


def read(name: str) -> dict[str, Any]:
    """What a plan of that name sets: fields of ``EnvConfig``, nested, values not yet checked.

    Raises:
        ValueError: no such plan, no TOML, or a key that no plan may set.
    """
    found = find(name)
    if isinstance(found, int):
        return deepcopy(_random_plan(found))
    try:
        values = tomllib.loads(read_text(found))
    except (OSError, UnicodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"env.plan={name}: allowed is a TOML file ({error})") from error
    for key, value in _leaves(values):
        if key not in KEYS:
            raise ValueError(f"env.plan={name}: {key}={value}: allowed keys are {', '.join(KEYS)}")
    return values


def _leaves(values: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Keys with dots and their values; a table without keys counts as a value."""
    for name, value in values.items():
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, f"{above}{name}.")
        elif not (
            isinstance(value, Mapping) and any(k.startswith(f"{above}{name}.") for k in KEYS)
        ):
            yield f"{above}{name}", value
