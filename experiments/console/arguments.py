"""What commands are given: numbers, files and run folders."""

from __future__ import annotations

import argparse
import math
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from conf import ConfigError
from conf.own_groups import override_of
from conf.user_paths import user_path
from training.run_folder import RunFolder

CONFIG_DIR = ("--config-dir", "-cd")
_OVERRIDE = re.compile(r"\+{0,2}[\w./]+=")


def run_folder(what: Sequence[str]) -> RunFolder | None:
    """The run's folder that arguments name, or its file of weights; None where they set keys.

    Raises:
        ConfigError: there are keys beside it.
    """
    folders = [user_path(item) for item in what if "=" not in item or user_path(item).is_dir()]
    if folders and len(what) > 1:
        raise ConfigError(f"{' '.join(what)}: allowed is one run folder, or KEY=VALUE ... alone.")
    return RunFolder.named(folders[0]) if folders else None


def with_config_dirs(arguments: Sequence[str]) -> list[str]:
    """A command's arguments with ``hydra.searchpath`` in the place of Hydra's ``--config-dir``.

    Raises:
        ConfigError: what stands behind the option is no folder.
    """
    rest, folders, left = [], [], iter(arguments)
    for item in left:
        option, equals, value = item.partition("=")
        if option not in CONFIG_DIR:
            rest.append(item)
            continue
        folder = user_path(value if equals else next(left, ""))
        if not folder.is_dir() or not folder.parts:
            raise ConfigError(f"{option} {folder}: allowed is a folder that exists.")
        folders.append(folder)
    if not folders:
        return rest
    # Beside other overrides, since options may stand before and behind all of them.
    place = next((n for n, item in enumerate(rest) if _OVERRIDE.match(item)), 0)
    return [*rest[:place], override_of(folders), *rest[place:]]


def check_place(option: str, file: Path | None) -> None:
    """Finds a place where no file can be written before anything is worked out.

    Raises:
        ConfigError: the option's file is a folder, or in none that can be written to.
    """
    if file is None:
        return
    if file.is_dir() or not file.absolute().parent.is_dir():
        raise ConfigError(f"{option} {file}: allowed is a file in a folder that exists.")
    if not os.access(file.absolute().parent, os.W_OK):
        raise ConfigError(f"{option} {file}: allowed is a file in a folder that can be written to.")


def positive(text: str) -> int:
    """An option's whole number of at least 1."""
    return int(_number(text, int, 1, math.inf, "a whole number of at least 1"))


def not_negative(text: str) -> int:
    """An option's whole number of at least 0."""
    return int(_number(text, int, 0, math.inf, "a whole number of at least 0"))


def port(text: str) -> int:
    """An option's port."""
    return int(_number(text, int, 0, 65_535, "a whole number from 0 to 65535"))


def deviation_db(text: str) -> float:
    """An option's deviation in dB, from 0 to 100."""
    return _number(text, float, 0, 100, "a number from 0 to 100")


def share(text: str) -> float:
    """An option's number from 0 to 1."""
    return _number(text, float, 0, 1, "a number from 0 to 1")


def _number(text: str, kind: Callable[[str], float], low: float, high: float, say: str) -> float:
    """Reads a number for argparse, which would name the function that fails with ValueError."""
    try:
        value = kind(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text}: allowed is {say}")
    return value
