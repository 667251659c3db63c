"""What a benchmark finds, and how a ratio is made of measurements that took turns."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Seconds = NDArray[np.float64]


class Skipped(Exception):  # noqa: N818 - nothing went wrong
    """A benchmark cannot be run here; the message says why."""


@dataclass(frozen=True)
class Threshold:
    """What a value should be: at least or below a bound."""

    bound: float
    at_least: bool

    def __str__(self) -> str:
        """As the table shows it."""
        return f"{'>=' if self.at_least else '<'} {self.bound:g}"

    def met(self, value: float) -> bool:
        """Whether a value is as it should be."""
        return value >= self.bound if self.at_least else value < self.bound


@dataclass(frozen=True)
class Result:
    """One measured number.

    Attributes:
        name: its key in ``bench.json``.
        value: the median over blocks, or over runs.
        unit: "ratio", "share" or what is counted.
        low: the least over blocks.
        high: the largest over blocks.
        how: how it was measured, in a line.
        target: what it should be, if there is a target.
        details: further numbers, by name.
    """

    name: str
    value: float
    unit: str
    low: float
    high: float
    how: str
    target: Threshold | None = None
    details: dict[str, float] = field(default_factory=dict)

    @classmethod
    def over(
        cls,
        name: str,
        blocks: Seconds,
        unit: str,
        how: str,
        target: Threshold | None = None,
        details: Mapping[str, float] | None = None,
    ) -> Result:
        """The median of a number measured once a block, shape (blocks,)."""
        low, middle, high = (float(q) for q in np.quantile(blocks, (0.0, 0.5, 1.0)))
        return cls(name, middle, unit, low, high, how, target, dict(details or {}))


def take_turns(
    variants: Mapping[str, Callable[[int], object]],
    steps: int,
    blocks: int,
    clock: Callable[[], Any] = time.process_time,
) -> dict[str, Seconds]:
    """Times variants block by block, each block in the reverse order of the one before.

    Args:
        variants: what to time, by name; called with the number of steps to take.
        steps: of a block.
        blocks: how many.
        clock: processor time of this process unless told otherwise; several at once as an array.

    Returns:
        Seconds per step of each block, by name, shape (blocks,), or (blocks, clocks).
    """
    order = list(variants)
    taken: dict[str, list[Any]] = {name: [] for name in order}
    for _ in range(blocks):
        for name in order:
            began = clock()
            variants[name](steps)
            taken[name].append((clock() - began) / steps)
        order.reverse()
    return {name: np.array(values) for name, values in taken.items()}


def micro(seconds: Seconds) -> float:
    """The median in microseconds."""
    return float(np.median(seconds)) * 1e6
