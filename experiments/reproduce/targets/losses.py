"""Losses: the default task, where uploads are lost, late or not asked for (docs/robustness.md)."""

from __future__ import annotations

from experiments.reproduce.results.runs import Run
from experiments.reproduce.targets.comparison import Column, Comparison, Variant
from experiments.reproduce.targets.plan import THREE_SEEDS

LOST = "federation.losses"
VARIANTS = (
    Variant(""),
    Variant("lost at random", f"{LOST}.probability=0.1"),
    Variant("lost at random", f"{LOST}.probability=0.3"),
    Variant("lost at random", f"{LOST}.probability=0.5"),
    Variant("lost at random", f"{LOST}.probability=0.9", quick=True),
    Variant("outage of the channel", f"{LOST}.outage_db=-85"),
    Variant("outage of the channel", f"{LOST}.outage_db=-70"),
    Variant("a window late", f"{LOST}.late=0.5", quick=True),
    Variant("not asked for", "federation.fraction=0.67"),
    Variant("not asked for", "federation.fraction=0.34", quick=True),
)


def in_time(run: Run) -> float:
    """Share of all robots' uploads that the server heard in their window."""
    uploads = run.summary["uploads"]
    return float(uploads["heard"] / sum(uploads.values()))


TARGET = Comparison(
    "losses",
    VARIANTS,
    ("env.robots=3",),
    THREE_SEEDS,
    extra={"heard in time": Column(in_time, ".2f")},
)
