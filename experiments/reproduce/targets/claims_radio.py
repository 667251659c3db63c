"""Claims on Fig. 4, energy efficiency by access, budget, robots and RIS, and on Fig. 5, QoE."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from experiments.reproduce.results.statistics import Floats, estimate
from experiments.reproduce.results.verdicts import Check, Claim
from experiments.reproduce.targets.fig4_points import (
    BEST,
    LEARNED,
    PLANNED,
    PLANNED_AGAIN,
    Of,
    PointOutcome,
    by_setting,
    mean,
)
from experiments.reproduce.targets.fig5 import Fig5Measures

FIG4 = "Section IV on Fig. 4"
FEW, MANY = 3, 4
"""K of which the paper says different things."""

KNEE = 20
"""M_R from which on the paper sees smaller improvements."""

AXES = {
    "robots": ("K", "K = {}"),
    "side": ("M_R", "M_R = {}"),
    "max_dbm": ("P_max", "{} dBm"),
    "access": ("access", "{}"),
}
"""How an axis is called, and a value of it."""

FIG5 = "Section IV on Fig. 5"
QOS, QOE = "qos", "qoe"
DECIBELS = "+.2f"

Held = Mapping[tuple[str, int, str], Floats]
"""A measure by metric, M_R and name, shape (seeds,)."""

By = Mapping[Of, Mapping[int, float]]
"""EE in bit/s/Hz/J, by setting and by seed."""

Pairs = Iterator[tuple[dict[str, str], Floats]]
"""Where two settings are compared, and what their difference is, seed by seed."""


def fig4_claims(found: Sequence[PointOutcome]) -> list[Claim]:
    """What the paper says of Fig. 4, of learned policies, also the best, and of planned ones."""
    by = {
        of: {seed: outcome.ee for seed, outcome in by_seed.items()}
        for of, by_seed in by_setting(found).items()
    }
    claims: list[Claim | None] = []
    for curve in (LEARNED, BEST, PLANNED):  # the best is there for some of the settings
        drawn = (PLANNED, PLANNED_AGAIN) if curve == PLANNED else (curve,)
        claims += _of_curve({of: ees for of, ees in by.items() if of.curve in drawn}, curve)
    return [claim for claim in claims if claim is not None]


def _of_curve(by: By, curve: str) -> Iterator[Claim | None]:
    gain = f"gain in EE, %, {curve}; mean over settings"
    abstract = f"abstract (iii), {FIG4}"
    noma = "NOMA has a higher EE than OMA"
    yield claim(noma, abstract, gain, _noma(by, curve, curve))
    if curve == PLANNED:
        again = f"{noma} whose parts of arrived robots go to the others"
        yield claim(again, "", gain, _noma(by, curve, PLANNED_AGAIN))
    yield claim("EE grows with P_max", FIG4, gain, _grown(by, curve, "max_dbm"))
    yield claim("EE grows with the number of robots", FIG4, gain, _grown(by, curve, "robots"))
    yield claim("the RIS raises EE", FIG4, gain, _with_ris(by, curve))
    for k in (FEW, MANY):
        of_k = {of: ees for of, ees in by.items() if of.robots == k}
        yield claim(f"EE grows with M_R at K = {k}", FIG4, gain, _grown(of_k, curve, "side"))
    flatter = f"at K = {FEW} EE improves less for M_R above {KNEE} than below"
    change = f"the improvement above less that below, % of the EE below, {curve}; mean"
    for how, a_row in (("in all", False), ("for each row of elements that is added", True)):
        steps = _flattening(by, curve, a_row=a_row)
        yield claim(f"{flatter}, {how}", FIG4, change, steps, above=False)


def claim(
    says: str, where: str, measure: str, pairs: Pairs, form: str = "+.1f", *, above: bool = True
) -> Claim | None:
    """A claim that differences lie above zero, or below; None where nothing was compared."""
    each = list(pairs)
    if not each:
        return None
    checks = [Check(setting, estimate(values, mean), above=above) for setting, values in each]
    pooled = estimate(np.mean([values for _, values in each], axis=0), mean)
    return Claim(says, measure, checks, where, pooled=pooled, form=form)


def _noma(by: By, curve: str, rival: str) -> Pairs:
    for of in by:
        oma = of._replace(access="oma", curve=rival)
        if of.access == "noma" and of.curve == curve and oma in by:
            yield _setting(of, "robots", "side", "max_dbm"), _percent(by[of], by[oma])


def _grown(by: By, curve: str, axis: str) -> Pairs:
    """Each value of an axis over the next smaller one."""
    values = sorted({getattr(of, axis) for of in by})
    before = dict(zip(values[1:], values, strict=False))
    others = [name for name in AXES if name != axis]
    for of in by:
        here = getattr(of, axis)
        if of.curve == curve and here in before:
            below = by[of._replace(**{axis: before[here]})]
            name, text = AXES[axis]
            step = f"{text.format(here)} over {before[here]}"
            yield {name: step, **_setting(of, *others)}, _percent(by[of], below)


def _with_ris(by: By, curve: str) -> Pairs:
    for of in by:
        without = of._replace(side=0)
        if of.curve == curve and of.side and without in by:
            yield _setting(of, *AXES), _percent(by[of], by[without])


def _flattening(by: By, curve: str, *, a_row: bool) -> Pairs:
    """With few robots, the step in M_R above the knee less the one below, in % of the EE below.

    With ``a_row`` a step is divided by the rows of elements that it adds.
    """
    sides = sorted({of.side for of in by})
    if KNEE not in sides[1:-1]:
        return
    at = sides.index(KNEE)
    below, above = sides[at - 1], sides[at + 1]
    widths = (above - KNEE, KNEE - below) if a_row else (1, 1)
    for of in by:
        if (of.robots, of.side, of.curve) == (FEW, KNEE, curve):
            low, knee, high = (_values(by[of._replace(side=side)]) for side in (below, KNEE, above))
            less = (high - knee) / widths[0] - (knee - low) / widths[1]
            yield _setting(of, "max_dbm", "access"), 100.0 * less / low


def _setting(of: Of, *axes: str) -> dict[str, str]:
    """A setting as a check has it."""
    return {AXES[axis][0]: AXES[axis][1].format(getattr(of, axis)) for axis in axes}


def _percent(ours: Mapping[int, float], theirs: Mapping[int, float]) -> Floats:
    """By how much more, seed by seed."""
    return 100.0 * (_values(ours) / _values(theirs) - 1.0)


def _values(ees: Mapping[int, float]) -> Floats:
    """Shape (seeds,), the least seed first."""
    return np.array([ees[seed] for seed in sorted(ees)])


def fig5_claims(rows: Sequence[Fig5Measures]) -> list[Claim]:
    """What the paper says of Fig. 5, of learned policies and of planned ones."""
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
        "QoS has a higher EE than QoE", FIG5, f"gain in EE, {percent}", _ratio(held, "ee", QOS)
    )
    yield claim(
        "with QoE the worst robot has a higher rate than with QoS",
        FIG5,
        f"gain in the least rate, {percent}",
        _ratio(held, "min_rate", QOE),
    )
    better = "QoS keeps better channels than QoE"
    gain = "mean channel gain along the way"
    difference = f"difference in dB of the {gain}, {starts}"
    yield claim(better, FIG5, difference, _channels(held), DECIBELS)
    yield claim(
        f"{better}, the more so for M_R > {KNEE}",
        FIG5,
        f"that difference for M_R > {KNEE} less that for others, {policy}",
        _wider(held),
        DECIBELS,
    )
    over_none = f"gain in dB of the {gain} over M_R = 0, QoS, {starts}"
    yield claim("the RIS enhances the channels", FIG5, over_none, _improved(held), DECIBELS)


def _sides(held: Held) -> list[int]:
    return sorted({side for _, side, _ in held})


def _at(side: int) -> dict[str, str]:
    return {"M_R": f"M_R = {side}"}


def _ratio(held: Held, name: str, metric: str) -> Pairs:
    """By how much a measure is larger with one metric than with the other, in %."""
    other = QOE if metric == QOS else QOS
    for side in _sides(held):
        yield _at(side), 100.0 * (held[metric, side, name] / held[other, side, name] - 1.0)


def _better_db(held: Held) -> dict[int, Floats]:
    """By how many dB QoS's channels are better than QoE's, by M_R."""
    return {side: held[QOS, side, "gain_db"] - held[QOE, side, "gain_db"] for side in _sides(held)}


def _channels(held: Held) -> Pairs:
    for side, db in _better_db(held).items():
        yield _at(side), db


def _wider(held: Held) -> Pairs:
    better_db = _better_db(held)
    small = [db for side, db in better_db.items() if side <= KNEE]
    large = [db for side, db in better_db.items() if side > KNEE]
    if small and large:
        yield {"M_R": f"M_R > {KNEE}"}, np.mean(large, axis=0) - np.mean(small, axis=0)


def _improved(held: Held) -> Pairs:
    sides = _sides(held)
    for side in sides[1:] if 0 in sides else ():
        yield _at(side), held[QOS, side, "gain_db"] - held[QOS, 0, "gain_db"]
