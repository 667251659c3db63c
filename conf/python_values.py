"""Overrides as they are written in Python: texts, or keys with Python's values."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from typing import Any

from conf.errors import ConfigError
from conf.user_paths import quoted

Overrides = str | Iterable[str] | Mapping[str, Any]
"""``["env.robots=4", "seed=1"]``, or ``{"env.robots": 4, "seed": 1}``."""

_WORD = re.compile(r"(?!(?:true|false|null|nan|inf)$)[a-z_]\w*", re.IGNORECASE | re.ASCII)
"""Text that Hydra reads as such without quotes: the name of a group's choice must have none."""


def override_texts(overrides: Overrides) -> list[str]:
    """Overrides as Hydra takes them, each a text.

    Args:
        overrides: texts such as ``env.robots=4``, or from a key, or a group, to its value.

    Raises:
        ConfigError: something else than a text, or a value that no key can have.
    """
    if isinstance(overrides, Mapping):
        return [f"{key}={value_text(key, value)}" for key, value in overrides.items()]
    texts = [overrides] if isinstance(overrides, str) else list(overrides)
    for text in texts:
        if not isinstance(text, str):
            raise ConfigError(f'{text!r}: allowed is a text such as "env.robots=4".')
    return texts


def grid_texts(grid: Mapping[str, Iterable[Any]]) -> list[str]:
    """Overrides that list several values each, as Hydra takes them in a sweep.

    Args:
        grid: from a key, or a group, to its values, at least one.

    Raises:
        ConfigError: no values, or one that no key can have.
    """
    found = []
    for key, values in grid.items():
        several = isinstance(values, Iterable) and not isinstance(values, str | Mapping)
        if not (listed := [*values] if several else []):
            raise ConfigError(f"{key}={values!r}: allowed is a list of values.")
        found.append(f"{key}={','.join(value_text(key, value) for value in listed)}")
    return found


def value_text(key: str, value: Any) -> str:
    """A value of Python's as it stands behind ``KEY=``.

    Args:
        key: whose it is, for the error.
        value: None, a truth value, a number, a text, a path, or lists of these, or mappings to
            them from words; NumPy's as well.

    Raises:
        ConfigError: something else.
    """
    if hasattr(value, "tolist"):  # NumPy's numbers and arrays
        value = value.tolist()
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str | os.PathLike):
        text = os.fspath(value)
        return text if _WORD.fullmatch(text) else quoted(text)
    if isinstance(value, list | tuple | range):
        return f"[{','.join(value_text(key, item) for item in value)}]"
    if isinstance(value, Mapping) and all(_WORD.fullmatch(str(name)) for name in value):
        return f"{{{','.join(f'{name}:{value_text(key, it)}' for name, it in value.items())}}}"
    allowed = "None, a truth value, a number, a text, a path, a list, or a mapping from words"
    raise ConfigError(f"{key}={value!r}: allowed is {allowed}.")
