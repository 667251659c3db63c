"""Tables of one task with one thing changed at a time: what all such targets have in common."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from experiments.reproduce.results import statistics
from experiments.reproduce.results.output import Row, write_csv, write_table
from experiments.reproduce.results.runs import Run, Runs
from experiments.reproduce.results.statistics import Estimate, Floats, difference
from experiments.reproduce.targets.plan import QUICK_SEEDS, Cell

MEASURES = {"success": ".2f", "path_ratio": ".3f", "ee": ".4f", "sum_rate": ".1f"}
NOTE = (
    "Means over the last five evaluations in training, eps = .05 (path ratio: greedy); the"
    " interquartile mean over seeds, and in brackets the 95 % bootstrap interval. Differences are"
    " from the default, seed by seed. Intervals over so few seeds are rough. Converged: in"
    " episodes; ≥ marks a bound, where runs had not converged when they ended."
)


@dataclass(frozen=True)
class Variant:
    """One thing that is changed.

    Attributes:
        group: its theme.
        overrides: Hydra's, in one line; none is what the others are compared with.
        name: of its cell and row; the overrides if empty.
        quick: whether the quick scale has it, too.
    """

    group: str
    overrides: str = ""
    name: str = ""
    quick: bool = False

    @property
    def label(self) -> str:
        """The name of its cell: without what only makes its checkpoints as rare as others'."""
        items = [item for item in self.overrides.split() if not item.startswith("state.every")]
        return self.name or " ".join(items) or "default"


@dataclass(frozen=True)
class Change:
    """What a variant came to.

    Attributes:
        variant: which.
        values: of each measure, with its interval.
        differences: from the baseline, seed by seed.
        converged: in episodes.
        there: runs that converged.
        extra: of each column of a target's own.
    """

    variant: Variant
    values: dict[str, Estimate]
    differences: dict[str, Estimate]
    converged: Estimate
    there: int
    extra: dict[str, Estimate]


@dataclass(frozen=True)
class Comparison:
    """A target that trains variants and compares each with the first one.

    Attributes:
        name: as on the command line, and of its files.
        variants: what is trained, the baseline first.
        common: overrides of all.
        seeds: of the full scale.
        quick_common: overrides of the quick scale beside them.
        extra: columns of its own: what a run has to say there, by title.
        formats: of those columns.
        note: beneath the table.
    """

    name: str
    variants: Sequence[Variant]
    common: tuple[str, ...]
    seeds: tuple[int, ...]
    quick_common: tuple[str, ...] = ("train.episodes=150",)
    extra: Mapping[str, Callable[[Run], float]] = field(default_factory=dict)
    formats: Mapping[str, str] = field(default_factory=dict)
    note: str = NOTE

    def cells(self, quick: bool) -> list[Cell]:
        """See ``Target``."""
        seeds = QUICK_SEEDS if quick else self.seeds
        common = (*self.common, *(self.quick_common if quick else ()))
        first = self.variants[0]
        return [
            Cell(each.label, (*common, *each.overrides.split()), seeds)
            for each in self.variants
            if each is first or each.quick or not quick
        ]

    def report(self, runs: Runs, out: Path, *, quick: bool) -> list[Path]:
        """See ``Target``."""
        found = self.changes(runs)
        return [
            self._write_table(out / f"{self.name}.md", found),
            self._write_csv(out / f"{self.name}.csv", found),
            self._write_runs(out / f"{self.name}_runs.csv", runs),
        ]

    def changes(self, runs: Runs) -> list[Change]:
        """Every variant that was trained, the baseline first."""
        baseline = runs[self.variants[0].label]
        found = []
        for variant in self.variants:
            if variant.label not in runs:
                continue
            ours = [runs[variant.label][seed] for seed in sorted(runs[variant.label])]
            theirs = [baseline[run.seed] for run in ours]
            times = statistics.times(ours, "episode")
            found.append(
                Change(
                    variant,
                    {key: statistics.estimate(last5(ours, key)) for key in MEASURES},
                    {key: difference(last5(ours, key), last5(theirs, key)) for key in MEASURES},
                    statistics.converged(times),
                    int((~times.censored).sum()),
                    {
                        title: statistics.estimate(np.array([value(run) for run in ours]))
                        for title, value in self.extra.items()
                    },
                )
            )
        return found

    def _write_table(self, path: Path, changes: Sequence[Change]) -> Path:
        header = ("", "changed", *self.extra, "success", "path ratio", "EE", "converged")
        rows: list[Row] = []
        for change in changes:
            own = [change.extra[title].text(self.formats.get(title, ".3g")) for title in self.extra]
            values = [
                change.values[key].text(MEASURES[key]) for key in ("success", "path_ratio", "ee")
            ]
            when = f"{change.converged.text('.0f')}, {change.there} of {change.converged.count}"
            keys = ("success", "ee")
            deltas = [change.differences[key].text("+" + MEASURES[key]) for key in keys]
            if change is changes[0]:
                deltas = ["", ""]
            label = change.variant.label
            shown = label if change.variant.name else f"`{label}`"
            rows.append((change.variant.group, shown, *own, *values, when, *deltas))
        return write_table(path, (*header, "Δ success", "Δ EE"), rows, self.note)

    def _write_csv(self, path: Path, changes: Sequence[Change]) -> Path:
        header = ("group", "changed", "measure", "value", "low", "high", "seeds", "bound")
        rows: list[Row] = []
        for change in changes:
            named = {key: change.values[key] for key in MEASURES}
            named |= {f"{key}_difference": change.differences[key] for key in MEASURES}
            named["converged_episode"] = change.converged
            named |= change.extra
            rows += [
                (change.variant.group, change.variant.label, key, *_numbers(estimate))
                for key, estimate in named.items()
            ]
        return write_csv(path, header, rows)

    def _write_runs(self, path: Path, runs: Runs) -> Path:
        """A row a run."""
        rows = []
        for name, by_seed in runs.items():
            for seed, run in by_seed.items():
                when = (run.summary["converged"] or {}).get("episode")
                values = [float(last5([run], key)[0]) for key in MEASURES]
                own = [value(run) for value in self.extra.values()]
                rows.append((name, seed, *values, when, *own))
        header = ("changed", "seed", *MEASURES, "converged_episode", *self.extra)
        return write_csv(path, header, rows)


def last5(runs: Sequence[Run], measure: str) -> Floats:
    """A measure of each run, the mean over its last five evaluations; nan where nobody arrived."""
    found = [run.summary["evaluation"]["last5"][measure] for run in runs]
    return np.array([np.nan if value is None else value for value in found], float)


def _numbers(estimate: Estimate) -> tuple[float, float, float, int, str]:
    return estimate.value, estimate.low, estimate.high, estimate.count, estimate.bound
