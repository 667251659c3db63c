"""Turns: work that pauses wherever others may be served before it goes on.

A run pauses once a tick, when every agent has been told what it needs to choose its next action.
Alone, it goes straight on; runs that are trained together take turns, and their agents choose and
learn in the pauses, all of them at once.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

T = TypeVar("T")
Turns = Generator[None, None, T]
"""Pauses, and what the work comes to in the end."""


def play_out(turns: Turns[T]) -> T:
    """Goes on to the end without a pause."""
    while True:
        try:
            next(turns)
        except StopIteration as end:
            result: T = end.value
            return result
