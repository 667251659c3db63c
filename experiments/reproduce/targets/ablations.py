"""Ablations: the default task with three robots, one thing changed at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from experiments.reproduce.results import statistics
from experiments.reproduce.results.output import Row, plain, save_figure, write_csv, write_table
from experiments.reproduce.results.runs import Run, Runs
from experiments.reproduce.results.statistics import Estimate, Floats, difference
from experiments.reproduce.targets.plan import QUICK_SEEDS, THREE_SEEDS, Cell

DEFAULT = "default"
QUICK_EPISODES = 150

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

MEASURES = {"success": ".2f", "path_ratio": ".3f", "ee": ".4f", "sum_rate": ".1f"}
NOTE = (
    "Means over the last five evaluations in training, eps = .05 (path ratio: greedy); the"
    " interquartile mean over seeds, and in brackets the 95 % bootstrap interval. Differences are"
    " from the default, seed by seed. Intervals over so few seeds are rough. Converged: in"
    " episodes; ≥ marks a bound, where runs had not converged when they ended."
)


@dataclass(frozen=True)
class Change:
    """What a change came to.

    Attributes:
        group: its theme.
        name: of its cell.
        values: of each measure, with its interval.
        differences: from the default, seed by seed.
        converged: in episodes.
        there: runs that converged.
    """

    group: str
    name: str
    values: dict[str, Estimate]
    differences: dict[str, Estimate]
    converged: Estimate
    there: int


class Ablations:
    """See the module."""

    name = "ablations"

    def cells(self, quick: bool) -> list[Cell]:
        """See ``Target``."""
        seeds = QUICK_SEEDS if quick else THREE_SEEDS
        common = ("env.robots=3", *((f"train.episodes={QUICK_EPISODES}",) if quick else ()))
        changes = [c for group in GROUPS.values() for c in (group[:1] if quick else group)]
        return [
            Cell(DEFAULT, common, seeds),
            *(Cell(_named(change), (*common, *change.split()), seeds) for change in changes),
        ]

    def report(self, runs: Runs, out: Path, *, quick: bool) -> list[Path]:
        """See ``Target``."""
        found = changes_of(runs)
        return [
            *save_figure(_draw(found), out, self.name, quick=quick),
            _write_table(out / "ablations.md", found),
            _write_csv(out / "ablations.csv", found),
            _write_runs(out / "ablations_runs.csv", runs),
        ]


TARGET = Ablations()


def _named(change: str) -> str:
    """A change without what only makes its checkpoints as rare as the others'."""
    return " ".join(item for item in change.split() if not item.startswith("state.every"))


def changes_of(runs: Runs) -> list[Change]:
    """Every change that was trained, after the default itself."""
    names = [(group, _named(c)) for group, changes in GROUPS.items() for c in changes]
    default = runs[DEFAULT]
    found = []
    for group, name in [("", DEFAULT), *names]:
        if name not in runs:
            continue
        ours = [runs[name][seed] for seed in sorted(runs[name])]
        theirs = [default[run.seed] for run in ours]
        times = statistics.times(ours, "episode")
        found.append(
            Change(
                group,
                name,
                {key: statistics.estimate(_last5(ours, key)) for key in MEASURES},
                {key: difference(_last5(ours, key), _last5(theirs, key)) for key in MEASURES},
                statistics.converged(times),
                int((~times.censored).sum()),
            )
        )
    return found


def _last5(runs: Sequence[Run], measure: str) -> Floats:
    """A measure of each run, the mean over its last five evaluations; nan where nobody arrived."""
    found = [run.summary["evaluation"]["last5"][measure] for run in runs]
    return np.array([np.nan if value is None else value for value in found], float)


def _draw(changes: Sequence[Change]) -> Figure:
    """Differences from the default with their intervals, a row a change."""
    rows = changes[1:]
    figure = Figure(figsize=(11, 1.6 + 0.3 * len(rows)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(rows))
    for axes, key, label in ((left, "success", "success"), (right, "ee", "EE in bit/s/Hz/J")):
        found = [change.differences[key] for change in rows]
        axes.axvline(0.0, color="#999999", linewidth=0.8)
        for place, each in zip(places, found, strict=True):
            axes.plot([each.low, each.high], [place, place], color="#2e86de", linewidth=2)
            axes.plot(each.value, place, "o", color="#2e86de", markersize=5)
        axes.set_xlabel(f"difference in {label} from the default")
        plain(axes)
    left.set_yticks(places, [change.name for change in rows], fontsize=9)
    left.invert_yaxis()
    seeds = max(change.values["success"].count for change in changes)
    figure.suptitle(
        f"K = 3, one thing changed: interquartile mean of {seeds} paired differences, 95 %"
        " bootstrap interval",
        fontsize=10,
    )
    return figure


def _write_table(path: Path, changes: Sequence[Change]) -> Path:
    header = ("", "changed", "success", "path ratio", "EE", "converged", "Δ success", "Δ EE")
    rows: list[Row] = []
    for change in changes:
        values = [change.values[key].text(MEASURES[key]) for key in ("success", "path_ratio", "ee")]
        when = f"{change.converged.text('.0f')}, {change.there} of {change.converged.count}"
        deltas = [change.differences[key].text("+" + MEASURES[key]) for key in ("success", "ee")]
        if change.name == DEFAULT:
            deltas = ["", ""]
        rows.append((change.group, f"`{change.name}`", *values, when, *deltas))
    return write_table(path, header, rows, NOTE)


def _write_csv(path: Path, changes: Sequence[Change]) -> Path:
    header = ("group", "changed", "measure", "value", "low", "high", "seeds", "bound")
    rows: list[Row] = []
    for change in changes:
        named = {key: change.values[key] for key in MEASURES}
        named |= {f"{key}_difference": change.differences[key] for key in MEASURES}
        named["converged_episode"] = change.converged
        rows += [
            (change.group, change.name, key, e.value, e.low, e.high, e.count, e.bound)
            for key, e in named.items()
        ]
    return write_csv(path, header, rows)


def _write_runs(path: Path, runs: Runs) -> Path:
    """A row a run."""
    rows = []
    for name, by_seed in runs.items():
        for seed, run in by_seed.items():
            when = (run.summary["converged"] or {}).get("episode")
            values = [float(_last5([run], key)[0]) for key in MEASURES]
            rows.append((name, seed, *values, when))
    return write_csv(path, ("changed", "seed", *MEASURES, "converged_episode"), rows)
