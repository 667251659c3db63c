"""The error that a user's mistake ends in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from env.validate import Problem


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
