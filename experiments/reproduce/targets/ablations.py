"""Ablations: the default task with three robots, one thing changed at a time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from experiments.reproduce.results.output import plain, save_figure
from experiments.reproduce.results.runs import Runs
from experiments.reproduce.targets.comparison import Change, Comparison, Variant
from experiments.reproduce.targets.plan import THREE_SEEDS

GROUPS: dict[str, tuple[str, ...]] = {
    "destination in the states": ("env.state.destination=none",),
    "discounts": (
        "agent.discount.robot=0.95",
        "agent.discount.robot=0.5",
        "agent.discount.ap=0.8",
        "agent.discount.ap=0.95",
    ),
    "guidance ψ": ("env.reward.guidance=0", "env.reward.guidance=1", "env.reward.guidance=6"),
    "reward of the goal": ("env.reward.goal=10", "env.reward.goal=30"),
    "N_F": (
        "federation.every=100",
        "federation.every=5 state.every=100",
        "federation.every=1 state.every=500",
        "strategy=none",
    ),
    "strategy": (
        "strategy=fedavgm",
        "strategy=fedadam",
        "strategy=fedmedian",
        "strategy=fedprox",
        "strategy=krum",
    ),
    "power": ("env.power.resolve=zero", "env.power.resolve=residual"),
    "response of the RIS": (
        "env.ris.response=near",
        "env.ris.response=far",
        "env.ris.response=rayleigh",
    ),
    "QoE": (
        "env.metric=qoe",
        "env.metric=qoe env.qoe.scale=5",
        "env.metric=qoe env.qoe.scale=15",
        "env.metric=qoe env.qoe.offset=1",
    ),
}
"""What is changed, by theme; the first of a theme is also in the quick scale."""


VARIANTS = [
    Variant(""),
    *(
        Variant(group, change, quick=change == changes[0])
        for group, changes in GROUPS.items()
        for change in changes
    ),
]


class Ablations(Comparison):
    """See the module."""

    def report(self, runs: Runs, out: Path, *, quick: bool) -> list[Path]:
        """See ``Target``."""
        figure = _draw(self.changes(runs))
        drawn = save_figure(figure, out, self.name, quick=quick)
        return [*drawn, *super().report(runs, out, quick=quick)]


TARGET = Ablations("ablations", VARIANTS, ("env.robots=3",), THREE_SEEDS)


def _draw(changes: Sequence[Change]) -> Figure:
    """Differences from the default with their intervals, a row a change."""
    rows = changes[1:]
    figure = Figure(figsize=(11, 1.6 + 0.3 * len(rows)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(rows))
    for axes, key, label in ((left, "success", "success"), (right, "ee", "EE in bit/s/Hz/J")):
        found = [change.estimates[f"{key}_difference"] for change in rows]
        axes.axvline(0.0, color="#999999", linewidth=0.8)
        for place, each in zip(places, found, strict=True):
            axes.plot([each.low, each.high], [place, place], color="#2e86de", linewidth=2)
            axes.plot(each.value, place, "o", color="#2e86de", markersize=5)
        axes.set_xlabel(f"difference in {label} from the default")
        plain(axes)
    left.set_yticks(places, [change.variant.label for change in rows], fontsize=9)
    left.invert_yaxis()
    seeds = max(change.estimates["success"].seeds for change in changes)
    figure.suptitle(
        f"K = 3, one thing changed: interquartile mean of {seeds} paired differences, 95 %"
        " bootstrap interval",
        fontsize=10,
    )
    return figure
