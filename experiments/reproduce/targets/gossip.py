"""Gossip against FedAvg: four robots, among whom a ring is not the complete graph."""

from __future__ import annotations

from experiments.reproduce.targets.comparison import Comparison, Variant
from experiments.reproduce.targets.plan import THREE_SEEDS

VARIANTS = (
    Variant("the server", "", "FedAvg"),
    Variant("robots alone", "strategy=gossip strategy.graph=complete"),
    Variant("robots alone", "strategy=gossip strategy.graph=ring", quick=True),
    Variant("robots alone", "strategy=gossip strategy.graph=random"),
    Variant("nobody", "strategy=none"),
)

TARGET = Comparison("gossip", VARIANTS, ("env.robots=4",), THREE_SEEDS)
