"""Whether a claim holds: a rule that reads numbers and their intervals, and nothing else.

A claim is a list of checks, one for each setting in which it ought to hold; a check is a number
with its interval, and a threshold. A check *holds* if the whole interval is on the claimed side of
the threshold, *fails* if it is on the other, and is *open* if the threshold lies in it. A number
without an interval (one seed, or a count) is judged by its value, a bound by what it is sure of.

A claim *holds* if all its checks hold; *depends on* something if some do; *does not hold* if none
does and at least one fails; and is *not shown* if all are open.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import combinations

import numpy as np

from experiments.reproduce.results.statistics import Estimate


class ClaimResult(Enum):
    """What a check came to."""

    HOLDS = "holds"
    FAILS = "fails"
    OPEN = "open"


@dataclass(frozen=True)
class Check:
    """A number that ought to lie on one side of a threshold.

    Attributes:
        setting: where, from the name of an axis, such as K, to its value.
        number: what was measured, with its interval.
        threshold: in the number's unit.
        above: whether the number ought to be larger; smaller if not.
    """

    setting: Mapping[str, str]
    number: Estimate
    threshold: float = 0.0
    above: bool = True

    @property
    def result(self) -> ClaimResult:
        """See the module."""
        low, high = _ends(self.number)
        larger, smaller = low > self.threshold, high < self.threshold
        if not larger and not smaller:
            return ClaimResult.OPEN
        return ClaimResult.HOLDS if larger == self.above else ClaimResult.FAILS


@dataclass(frozen=True)
class Claim:
    """A claim and what it came to.

    Attributes:
        says: its content.
        measure: what our numbers are.
        checks: one for each setting in which it ought to hold, at least one.
        where: it stands in the paper; empty if the paper does not make it.
        paper: the paper's number; empty if it gives none.
        pooled: one number over all of them; None where each is told.
        form: how a number is written, such as ".1f".
        scale: times which it is written.
    """

    says: str
    measure: str
    checks: Sequence[Check]
    where: str = ""
    paper: str = ""
    pooled: Estimate | None = None
    form: str = ".1f"
    scale: float = 1.0

    @property
    def verdict(self) -> str:
        """See the module."""
        counts = Counter(check.result for check in self.checks)
        if counts[ClaimResult.HOLDS] == len(self.checks):
            return "holds"
        if counts[ClaimResult.HOLDS]:
            return f"depends on {', '.join(self.axes)}"
        return "does not hold" if counts[ClaimResult.FAILS] else "not shown"

    @property
    def axes(self) -> tuple[str, ...]:
        """The fewest axes that settle whether a check holds; all of them if no fewer do."""
        names = tuple(self.checks[0].setting)
        for count in range(1, len(names)):
            for some in combinations(names, count):
                groups = self._by_result(some).values()
                if len(set().union(*groups)) == sum(map(len, groups)):
                    return some
        return names

    @property
    def detail(self) -> str:
        """Where it holds and where not; empty where it is the same in every setting."""
        counts = Counter(check.result for check in self.checks)
        there = [result for result in ClaimResult if counts[result]]
        if len(there) == 1:
            return ""
        if len(self.axes) == 1:
            values = self._by_result(self.axes)
            return "; ".join(f"{r.value}: {', '.join(v for (v,) in values[r])}" for r in there)
        told = [f"{result.value} in {counts[result]}" for result in there]
        return f"{', '.join(told)} of {len(self.checks)} settings"

    @property
    def ours(self) -> str:
        """Our numbers as a table shows them."""
        if self.pooled is not None:
            return self.pooled.text(self.form, self.scale)
        return "; ".join(
            f"{', '.join(check.setting.values())}: {check.number.text(self.form, self.scale)}"
            for check in self.checks
        )

    def _by_result(self, axes: Sequence[str]) -> dict[ClaimResult, dict[tuple[str, ...], None]]:
        """The values of some axes with which a check comes to each result, in their order."""
        found: dict[ClaimResult, dict[tuple[str, ...], None]] = {}
        for check in self.checks:
            values = tuple(check.setting[axis] for axis in axes)
            found.setdefault(check.result, {})[values] = None
        return found


def exact(value: float) -> Estimate:
    """A number that is counted, not estimated."""
    return Estimate(value, np.nan, np.nan, 1)


def _ends(number: Estimate) -> tuple[float, float]:
    """The least and the largest that a number may be."""
    if number.bound == "?" or np.isnan(number.value):
        return -np.inf, np.inf
    if not np.isnan(number.low):
        return number.low, number.high
    least = -np.inf if number.bound == "≤" else number.value
    most = np.inf if number.bound == "≥" else number.value
    return least, most
