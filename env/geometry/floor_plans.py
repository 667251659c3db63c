"""Floor plans from plain TOML files: the built-in ones of ``plans`` here and a user's own."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from env.config import RoomConfig, TasksConfig, WallsConfig
from env.texts import read_text

FOLDER = Path(__file__).parent / "plans"
DEFAULT = "default"
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


def built_in() -> list[str]:
    """The names of the plans that come along."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def find(name: str) -> Path:
    """The file of a plan.

    Args:
        name: of a built-in plan; or the path of a file, relative to the working folder.

    Raises:
        ValueError: there is no such plan and no such file.
    """
    own = Path(name).expanduser()
    if name in built_in():
        return FOLDER / f"{name}.toml"
    if own.is_file():
        return own
    allowed = f"one of {', '.join(built_in())}, or the path of a TOML file that exists"
    raise ValueError(f"env.plan={name}: allowed is {allowed}")


def read(name: str) -> dict[str, Any]:
    """What a plan sets: fields of ``EnvConfig``, nested; types and values are not checked here.

    Args:
        name: of a built-in plan, or the path of a file.

    Raises:
        ValueError: no such plan, no TOML, or a key that no plan may set.
    """
    path = find(name)
    try:
        values = tomllib.loads(read_text(path))
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
