"""What differential privacy costs: success and efficiency against epsilon."""

from __future__ import annotations

import math

from experiments.reproduce.results.runs import Run
from experiments.reproduce.targets.comparison import NOTE, Comparison, Variant
from experiments.reproduce.targets.plan import THREE_SEEDS
from training.exchange.accounting import ACCOUNTANT

TICKS = 12_000
"""Of every run, so that all that average equally often make as many releases: 480 windows."""

VARIANTS = (
    Variant("none"),
    Variant("clip alone", "strategy/dp=central strategy.dp.noise=0"),
    Variant("central", "strategy/dp=central strategy.dp.noise=0.003"),
    Variant("central", "strategy/dp=central strategy.dp.noise=0.03", quick=True),
    Variant("central", "strategy/dp=central strategy.dp.noise=0.3"),
    Variant("adaptive clip", "strategy/dp=adaptive strategy.dp.noise=0.03"),
    Variant("local", "strategy/dp=local strategy.dp.noise=0.03", quick=True),
)
"""The first is what the others are compared with."""


def epsilon(run: Run) -> float:
    """What a run has spent; infinite where it promises nothing."""
    spent = (run.summary["privacy"] or {}).get("epsilon")
    return math.inf if spent is None else float(spent)


def releases(run: Run) -> float:
    """Windows after which weights were averaged."""
    return float(run.summary["windows"])


TARGET = Comparison(
    "privacy",
    VARIANTS,
    ("env.robots=3", f"train.max_ticks={TICKS}"),
    THREE_SEEDS,
    ("train.max_ticks=6000",),
    {"ε": epsilon, "releases": releases},
    {"ε": ".3g", "releases": ".0f"},
    f"{NOTE} ε at δ = 1e-5 over all releases of a run, by the {ACCOUNTANT}; ∞: no noise.",
)
