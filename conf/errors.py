"""The error that a user's mistake ends in."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from typing import Any

from env.validate import Problem

GLOBAL = (["experiment"], ["baseline"])
"""Groups whose files set keys of all others."""


class ConfigError(ValueError):
    """A mistake of the user's: the message names the key, the value and what is allowed."""

    @classmethod
    def of(cls, found: Sequence[Problem]) -> ConfigError:
        """The error for a list of problems, a sentence each."""
        return cls(
            "\n".join(f"{key}={shown(value)}: allowed is {say}." for key, value, say in found)
        )


def shown(value: Any) -> str:
    """A value as it stands on a command line."""
    return "null" if value is None else str(value).replace(", ", ",")


def first_sentence(error: Exception) -> str:
    """The first line of another library's message."""
    return str(error).strip().splitlines()[0]


def sentence(error: Exception) -> str:
    """What Hydra says of a file that it cannot compose, in one line: where, what and which key."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    where = re.match("(In '[^']+'): .* raised while composing config:", lines[0])
    if where is not None and len(lines) > 1:
        keys = [line.removeprefix("full_key: ") for line in lines if line.startswith("full_key: ")]
        hint = " (is its first line '# @package _global_'?)" if keys in GLOBAL else ""
        return (
            f"{where[1]}: {lines[1].rstrip('.')}{''.join(f' ({key})' for key in keys[:1])}{hint}."
        )
    if len(lines) > 2 and lines[1].startswith("Available options"):
        names = itertools.takewhile(lambda line: not line.endswith(":"), lines[2:])
        return f"{lines[0]}: allowed is one of {', '.join(names)}."
    return lines[0]
