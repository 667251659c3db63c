"""Folders with YAML groups and floor plans of the user's own, as ``hydra.searchpath`` names them.

Such a folder is built like ``conf``: ``experiment/mine.yaml`` in it is ``experiment=mine``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from hydra.core.override_parser.types import Override, QuotedString

from conf.errors import ConfigError
from conf.user_paths import quoted, user_path
from env.geometry import floor_plans
from env.texts import read_unmarked_text

KEY = "hydra.searchpath"
_SCHEME = "file://"


def override_of(folders: Iterable[Path]) -> str:
    """The one override that makes folders known to Hydra, whatever the working folder."""
    return f"{KEY}=[{','.join(quoted(_SCHEME + str(folder.absolute())) for folder in folders)}]"


def folders_of(overrides: Sequence[Override]) -> list[Path]:
    """The folders that overrides name, in their order.

    Raises:
        ConfigError: one is no folder that exists, or of a kind that cannot be looked into.
    """
    found = []
    for override in overrides:
        if override.key_or_group != KEY:
            continue
        if not isinstance(items := override.value(), list):
            raise ConfigError(f"{override.input_line}: allowed is a list, [file://DIR].")
        for item in items:
            text = str(item.text if isinstance(item, QuotedString) else item)
            folder = user_path(text.removeprefix(_SCHEME))
            if not folder.is_dir():
                allowed = "a list of folders that exist, as in [file:///home/me/conf]"
                raise ConfigError.of([(KEY, f"[{text}]", allowed)])
            found.append(folder.absolute())
    return found


def files(group: str, roots: Iterable[Path]) -> dict[str, list[Path]]:
    """The files of a group such as ``experiment`` in folders, by the name that chooses them."""
    found: dict[str, list[Path]] = {}
    for root in roots:
        for path in sorted((root / group).glob("*.yaml")):
            found.setdefault(path.stem, []).append(path)
    return found


def check_choice(override: Override, roots: Sequence[Path]) -> None:
    """Checks that what an override chooses of a group is one file that Hydra can read.

    Raises:
        ConfigError: it is not.
    """
    group, choices = override.key_or_group, files(override.key_or_group, roots)
    values = list(override.sweep_string_iterator()) if override.is_sweep_override() else None
    for value in values or [str(override.value())]:
        if value not in choices:
            raise ConfigError.of([(group, value, f"one of {', '.join(sorted(choices))}")])
        path, *others = choices[value]
        if others:
            allowed = f"a name that one file has, not {path} and {others[0]}"
            raise ConfigError.of([(group, value, allowed)])
        try:
            read_unmarked_text(path, "Hydra")
        except (OSError, UnicodeError) as error:
            raise ConfigError(f"{group}={value}: {path} cannot be read: {error}.") from error


def located_plan(name: Any, folders: Iterable[Path]) -> Any:
    """A floor plan's name, or its path where it is a file in one of the folders alone."""
    if isinstance(name, str):
        try:
            floor_plans.find(name)
        except ValueError:
            return located(name, folders)
    return name


def located(name: str, folders: Iterable[Path]) -> str:
    """A path, or the one in the folders where the working folder has no such file."""
    if not Path(name).expanduser().exists():
        for folder in folders:
            if (folder / name).is_file():
                return str(folder / name)
    return name
