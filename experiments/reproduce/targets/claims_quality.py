"""Claims on QoS against QoE and on channels, Fig. 5."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from experiments.reproduce.results.statistics import Floats
from experiments.reproduce.results.verdicts import Claim
from experiments.reproduce.targets.claims_efficiency import KNEE, Pairs, claim
from experiments.reproduce.targets.fig4_points import LEARNED, PLANNED
from experiments.reproduce.targets.fig5 import Fig5Measures

WHERE = "Section IV on Fig. 5"
QOS, QOE = "qos", "qoe"
DECIBELS = "+.2f"

Held = Mapping[tuple[str, int, str], Floats]
"""A measure by metric, M_R and name, shape (seeds,)."""


def fig5_claims(rows: Sequence[Fig5Measures]) -> list[Claim]:
    """What the paper says of Fig. 5, of learned policies and of planned ones.

    Args:
        rows: of ``fig5.held_out``.

    Returns:
        A claim for each that some of the settings bear on.
    """
    claims: list[Claim | None] = []
    for policy in (LEARNED, PLANNED):
        found: dict[tuple[str, int, str], list[float]] = {}
        for row in sorted((r for r in rows if r.policy == policy), key=lambda row: row.seed or 0):
            for name in ("ee", "min_rate", "gain_db"):
                found.setdefault((row.metric, row.side, name), []).append(getattr(row, name))
        claims += _of_policy({of: np.array(values) for of, values in found.items()}, policy)
    return [claim for claim in claims if claim is not None]


def _of_policy(held: Held, policy: str) -> Iterator[Claim | None]:
    starts = f"{policy}, held-out starts; mean over M_R"
    percent = f"%, {starts}"
    yield claim(
        "QoS has a higher EE than QoE", WHERE, f"gain in EE, {percent}", _ratio(held, "ee", QOS)
    )
    yield claim(
        "with QoE the worst robot has a higher rate than with QoS",
        WHERE,
        f"gain in the least rate, {percent}",
        _ratio(held, "min_rate", QOE),
    )
    better = "QoS keeps better channels than QoE"
    gain = "mean channel gain along the way"
    difference = f"difference in dB of the {gain}, {starts}"
    yield claim(better, WHERE, difference, _channels(held), DECIBELS)
    yield claim(
        f"{better}, the more so for M_R > {KNEE}",
        WHERE,
        f"that difference for M_R > {KNEE} less that for others, {policy}",
        _wider(held),
        DECIBELS,
    )
    over_none = f"gain in dB of the {gain} over M_R = 0, QoS, {starts}"
    yield claim("the RIS enhances the channels", WHERE, over_none, _improved(held), DECIBELS)


def _sides(held: Held) -> list[int]:
    return sorted({side for _, side, _ in held})


def _at(side: int) -> dict[str, str]:
    return {"M_R": f"M_R = {side}"}


def _ratio(held: Held, name: str, metric: str) -> Pairs:
    """By how much a measure is larger with one metric than with the other, in %."""
    other = QOE if metric == QOS else QOS
    for side in _sides(held):
        yield _at(side), 100.0 * (held[metric, side, name] / held[other, side, name] - 1.0)


def _channels(held: Held) -> Pairs:
    """By how many dB QoS's channels are better than QoE's."""
    for side in _sides(held):
        yield _at(side), held[QOS, side, "gain_db"] - held[QOE, side, "gain_db"]


def _wider(held: Held) -> Pairs:
    better_db = dict(zip(_sides(held), (db for _, db in _channels(held)), strict=True))
    small = [db for side, db in better_db.items() if side <= KNEE]
    large = [db for side, db in better_db.items() if side > KNEE]
    if small and large:
        yield {"M_R": f"M_R > {KNEE}"}, np.mean(large, axis=0) - np.mean(small, axis=0)


def _improved(held: Held) -> Pairs:
    sides = _sides(held)
    for side in sides[1:] if 0 in sides else ():
        yield _at(side), held[QOS, side, "gain_db"] - held[QOS, 0, "gain_db"]
