"""What differential privacy a run has kept: the accountant.

Gaussian mechanisms compose exactly: T releases, each with noise of the deviation z times what one
robot can change, are as private as one whose noise is sqrt(T) times smaller (Dong, Roth and Su,
2022, "Gaussian differential privacy", Corollary 3.3). One release of mu = 1/z has

    delta(epsilon) = Phi(mu/2 - epsilon/mu) - exp(epsilon) Phi(-mu/2 - epsilon/mu)

(Balle and Wang, 2018, arXiv:1805.06530, Theorem 8), which is solved for epsilon. Flower's
``RdpAccountant`` bounds the same from above, for a fixed clip alone, and needs ``dp-accounting``.
"""

from __future__ import annotations

import math
from typing import Any

from conf import Config

ACCOUNTANT = "exact composition of Gaussian mechanisms (Dong et al., 2022; Balle and Wang, 2018)"

UNITS = {
    "central": "all uploads of one robot, against none of its steps",
    "adaptive": "all uploads of one robot, against none of its steps and half a vote on the clip",
    "local": "all uploads of one robot, against any others",
}
"""What may differ between two runs that epsilon says are hard to tell apart."""

_SENSITIVITY = {"central": 1.0, "adaptive": 1.0, "local": 2.0}
"""How far that moves what noise is added to, over the clip."""

_STEPS = 200
"""Halvings, more than a double has bits."""


def spent(config: Config, releases: int) -> dict[str, Any] | None:
    """What ``summary.json`` says of a run's privacy; None where it asks for none.

    Releases are windows, whether or not a robot was heard in each. ``epsilon`` is None where there
    is no noise, or as good as none.
    """
    dp = config.strategy.dp
    if dp.name == "none":
        return None
    epsilon = None
    if dp.noise > 0 and releases > 0:
        found = epsilon_of(_SENSITIVITY[dp.name] * math.sqrt(releases) / dp.noise, dp.delta)
        epsilon = found if math.isfinite(found) else None
    return {
        "mechanism": dp.name,
        "unit": UNITS[dp.name],
        "epsilon": epsilon,
        "delta": dp.delta,
        "releases": releases,
        "accountant": ACCOUNTANT,
    }


def epsilon_of(mu: float, delta: float) -> float:
    """The smallest epsilon of a Gaussian mechanism at a delta, rounded up.

    Args:
        mu: how far one robot moves the result, in deviations of its noise; above 0.
        delta: above 0, below 1.
    """
    low, high = -mu / 2, math.sqrt(2 * math.log(1 / delta))  # above: Bun and Steinke, 2016
    for _ in range(_STEPS):
        middle = (low + high) / 2
        low, high = (middle, high) if _delta(mu, middle) > delta else (low, middle)
    return mu * (high + mu / 2)


def delta_of(mu: float, epsilon: float) -> float:
    """The delta of a Gaussian mechanism at an epsilon; arguments as ``epsilon_of``."""
    return _delta(mu, epsilon / mu - mu / 2)


def _delta(mu: float, y: float) -> float:
    """The same at epsilon = mu (y + mu/2), without numbers that grow with it."""
    x = y + mu
    if x < 30:
        return _tail(y) - math.exp((x * x - y * y) / 2) * _tail(x)
    mills = (1 - 1 / (x * x)) / (x * math.sqrt(2 * math.pi))  # to 3 / x^4
    return _tail(y) - math.exp(-y * y / 2) * mills


def _tail(x: float) -> float:
    """The probability that a standard normal number is above ``x``."""
    return math.erfc(x / math.sqrt(2)) / 2
