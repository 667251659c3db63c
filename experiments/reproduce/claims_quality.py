"""Claims on QoS against QoE and on channels, Fig. 5."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from experiments.reproduce.claims_efficiency import KNEE, Pairs, claim
from experiments.reproduce.fig5 import LEARNED, PLANNED, Values
from experiments.reproduce.statistics import Floats
from experiments.reproduce.verdicts import Claim

WHERE = "Section IV on Fig. 5"
QOS, QOE = "qos", "qoe"

Held = Mapping[tuple[str, int, str], Floats]
"""A measure by metric, M_R and name, shape (seeds,)."""


def fig5_claims(rows: Sequence[Values]) -> list[Claim]:
    """What the paper says of Fig. 5, of learned policies and of planned ones.

    Args:
        rows: of ``fig5.held_out``.

    Returns:
        A claim for each that some of the settings bear on.
    """
    claims = [
        claim
        for policy in (LEARNED, PLANNED)
        for claim in _of_policy(_held([row for row in rows if row["policy"] == policy]), policy)
    ]
    return [claim for claim in claims if claim is not None]


def _held(rows: Sequence[Values]) -> Held:
    found: dict[tuple[str, int, str], list[float]] = {}
    for row in sorted(rows, key=lambda row: int(str(row["seed"]))):
        for name in ("ee", "min_rate", "gain_db"):
            of = str(row["metric"]), int(str(row["side"])), name
            found.setdefault(of, []).append(float(str(row[name])))
    return {of: np.array(values) for of, values in found.items()}


def _of_policy(held: Held, policy: str) -> Iterator[Claim | None]:
    starts = f"{policy}, held-out starts; mean over M_R"
    sides = sorted({side for _, side, _ in held})

    def percent(name: str, ours: str, theirs: str) -> Pairs:
        for side in sides:
            ratio = held[ours, side, name] / held[theirs, side, name]
            yield {"M_R": f"M_R = {side}"}, 100.0 * (ratio - 1.0)

    def decibels(side: int) -> Floats:
        return held[QOS, side, "gain_db"] - held[QOE, side, "gain_db"]

    def channels() -> Pairs:
        for side in sides:
            yield {"M_R": f"M_R = {side}"}, decibels(side)

    def wider() -> Pairs:
        small, large = ([s for s in sides if (s > KNEE) == above] for above in (False, True))
        if small and large:
            means = [np.mean([decibels(side) for side in part], axis=0) for part in (small, large)]
            yield {"M_R": f"M_R > {KNEE}"}, means[1] - means[0]

    def improved() -> Pairs:
        for side in (side for side in sides if side and 0 in sides):
            gain_db = held[QOS, side, "gain_db"] - held[QOS, 0, "gain_db"]
            yield {"M_R": f"M_R = {side}"}, gain_db

    better = "QoS keeps better channels than QoE"
    gain = "mean channel gain along the way"
    yield claim(
        "QoS has a higher EE than QoE", WHERE, f"gain in EE, %, {starts}", percent("ee", QOS, QOE)
    )
    yield claim(
        "with QoE the worst robot has a higher rate than with QoS",
        WHERE,
        f"gain in the least rate, %, {starts}",
        percent("min_rate", QOE, QOS),
    )
    yield claim(better, WHERE, f"difference in dB of the {gain}, {starts}", channels(), "+.2f")
    yield claim(
        f"{better}, the more so for M_R > {KNEE}",
        WHERE,
        f"that difference for M_R > {KNEE} less that for others, {policy}",
        wider(),
        "+.2f",
    )
    yield claim(
        "the RIS enhances the channels",
        WHERE,
        f"gain in dB of the {gain} over M_R = 0, QoS, {starts}",
        improved(),
        "+.2f",
    )
