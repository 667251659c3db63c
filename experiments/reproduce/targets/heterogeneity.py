"""Robots that differ: what stays their own, or how they count, where states hide their goals."""

from __future__ import annotations

from experiments.reproduce.targets.comparison import Comparison, Variant
from experiments.reproduce.targets.plan import SEEDS

VARIANTS = (
    Variant("one model", "", "FedAvg"),
    Variant("one model", "strategy=fedprox"),
    Variant("one model", "strategy=visits"),
    Variant("own parts", "federation.own=heads", quick=True),
    Variant("own parts", "federation.own=trunk"),
    Variant("own parts", "federation.own=input", quick=True),
    Variant("own parts", "federation.own=normalisation"),
    Variant("own networks", "strategy=none"),
    Variant("own networks", "strategy=gossip strategy.graph=random"),
)

TARGET = Comparison(
    "heterogeneity",
    VARIANTS,
    ("experiment=paper_literal", "env.robots=3", "train.episodes=60", "evaluation.every=5"),
    SEEDS,
    quick_common=("train.episodes=30",),
)
