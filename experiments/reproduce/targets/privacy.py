"""What differential privacy costs: success and efficiency against epsilon."""

from __future__ import annotations

import math

from experiments.reproduce.results.runs import Run
from experiments.reproduce.targets.comparison import NOTE, Column, Comparison, Variant
from experiments.reproduce.targets.plan import THREE_SEEDS
from training.exchange.accounting import ACCOUNTANT

COMMON = ("env.robots=3", "train.max_ticks=10000", "agent.epsilon.ticks=4000")
"""400 windows, or 100 of four times the length; by default robots explore as long as that."""

VARIANTS = (
    Variant("none"),
    Variant("clip alone", "strategy/dp=central strategy.dp.noise=0"),
    Variant("central", "strategy/dp=central strategy.dp.noise=0.1", quick=True),
    Variant("central", "strategy/dp=central strategy.dp.noise=1"),
    Variant("adaptive clip", "strategy/dp=adaptive strategy.dp.noise=0.1"),
    Variant("local", "strategy/dp=local strategy.dp.noise=0.1", quick=True),
    Variant("N_F = 100", "federation.every=100"),
    Variant(
        "N_F = 100",
        "federation.every=100 strategy/dp=central strategy.dp.noise=0.1 strategy.dp.clip=0.2",
    ),
)


def epsilon(run: Run) -> float:
    """What a run has spent; nan where it promises nothing."""
    spent = (run.summary["privacy"] or {}).get("epsilon")
    return math.nan if spent is None else float(spent)


TARGET = Comparison(
    "privacy",
    VARIANTS,
    COMMON,
    THREE_SEEDS,
    ("train.max_ticks=5000",),
    {"ε": Column(epsilon, ",.0f"), "releases": Column(lambda run: run.summary["windows"], ".0f")},
    f"{NOTE} ε at δ = 1e-5 over all releases of a run, by the {ACCOUNTANT} (-: no noise).",
)
