"""Attacks: rules of aggregation against robots that upload falsely (docs/robustness.md)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from experiments.reproduce.results.output import Row, write_table
from experiments.reproduce.results.runs import Run
from experiments.reproduce.targets.comparison import Change, Comparison, Variant
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
        _row(robots, hostile, attack),
        f"env.robots={robots} {chosen} {false}" + (LEVELS if robots == 7 else ""),
        f"K={robots} {attack}, {rule}",
        quick=robots == 4 and attack == "flip" and rule in ("mean", "median"),
    )


def _row(robots: int, hostile: int, attack: str) -> str:
    return f"K = {robots}, " + (attack if attack == "none" else f"{hostile} hostile: {attack}")


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
        cells = {
            (each.variant.group, _rule(each)): f"{each.extra[HONEST].value:.2f}" for each in changes
        }
        groups = dict.fromkeys(each.variant.group for each in changes)
        rows: list[Row] = [
            (group, *(cells.get((group, rule), "-") for rule in RULES)) for group in groups
        ]
        return write_table(path, ("", *RULES), rows, self.note)


def _rule(change: Change) -> str:
    return change.variant.name.split(", ")[1]


TARGET = Attacks(
    "attacks",
    _variants(),
    ("train.max_ticks=15000", "train.episodes=100000"),
    THREE_SEEDS,
    quick_common=("train.max_ticks=5000",),
    extra={HONEST: honest_arrivals},
    note=NOTE,
)
