"""Attacks: rules of aggregation against robots that upload falsely (docs/robustness.md)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from experiments.reproduce.results.output import write_table
from experiments.reproduce.results.runs import Run
from experiments.reproduce.targets.comparison import Change, Column, Comparison, Variant
from experiments.reproduce.targets.plan import THREE_SEEDS

RULES = {
    "mean": "strategy=fedavg",
    "median": "strategy=fedmedian",
    "trimmed mean": "strategy=fedtrimmedavg",
    "Krum": "strategy=krum",
    "Multi-Krum": "strategy=multikrum strategy.selected=3",
    "Bulyan": "strategy=bulyan strategy.malicious=1",
}
CUT_TWO = " strategy.trim=0.34"  # of six robots
LEVELS = " env.power.levels=7"  # one for each of seven robots
ATTACKS = ("none", "noise", "flip", "scale", "stale")
HONEST = "honest robots' arrivals"
NOTE = (
    "Share of greedy episodes from held-out starts, after training, in which an honest robot"
    " arrives; the interquartile mean over seeds. All robots then hold the same model. A dash: not"
    " run; of four robots the trimmed mean is the median. Bulyan needs K >= 4f + 3: with 4 and 6"
    " robots f = 0, where it is the mean."
)


def _variant(robots: int, hostile: int, attack: str, rule: str) -> Variant:
    chosen = RULES[rule] + (CUT_TWO if robots == 6 and rule == "trimmed mean" else "")
    false = "attack=none" if attack == "none" else f"attack={attack} attack.robots={hostile}"
    return Variant(
        f"K = {robots}, " + (attack if attack == "none" else f"{hostile} hostile: {attack}"),
        f"env.robots={robots} {chosen} {false}" + (LEVELS if robots == 7 else ""),
        f"K={robots} {attack}, {rule}",
        quick=robots == 4 and attack == "flip" and rule in ("mean", "median"),
    )


def _variants() -> list[Variant]:
    four = ("mean", "median", "Krum", "Multi-Krum")
    six = ("mean", "median", "trimmed mean", "Krum")
    found = [_variant(4, 1, attack, rule) for attack in ATTACKS for rule in four]
    found += [_variant(6, 2, attack, rule) for attack in ATTACKS for rule in six]
    seven = ("mean", "Bulyan")
    return found + [_variant(7, 1, attack, rule) for attack in ("none", "flip") for rule in seven]


def honest_arrivals(run: Run) -> float:
    """Mean share of greedy episodes in which robots arrive that upload what they learned."""
    honest = run.config.env.robots - run.config.attack.robots
    return float(np.mean(run.summary["arrivals"][:honest]))


class Attacks(Comparison):
    """See the module: a row for each attack, a column for each rule."""

    def _write_table(self, path: Path, changes: Sequence[Change]) -> Path:
        found: dict[str, dict[str, str]] = {}
        for each in changes:
            rule = each.variant.name.split(", ")[1]
            found.setdefault(each.variant.group, {})[rule] = f"{each.estimates[HONEST].value:.2f}"
        rows = [
            (group, *(cells.get(rule, "-") for rule in RULES)) for group, cells in found.items()
        ]
        return write_table(path, ("", *RULES), rows, self.note)


TARGET = Attacks(
    "attacks",
    _variants(),
    ("train.max_ticks=15000", "train.episodes=100000"),
    THREE_SEEDS,
    quick_common=("train.max_ticks=5000",),
    extra={HONEST: Column(honest_arrivals, ".2f")},
    note=NOTE,
)
