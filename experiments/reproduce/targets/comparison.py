"""Tables of one task with one thing changed at a time: what all such targets have in common."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.reproduce.results import statistics
from experiments.reproduce.results.output import Row, write_csv, write_table
from experiments.reproduce.results.runs import Run, Runs
from experiments.reproduce.results.statistics import Estimate, Floats, difference, estimate
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
        estimates: by name: of each measure ``NAME``, its ``NAME_difference`` from the baseline seed
            by seed, ``converged_episode``, and the columns of a target's own.
        there: runs that converged.
    """

    variant: Variant
    estimates: dict[str, Estimate]
    there: int


class Column(NamedTuple):
    """A column of a target's own: what a run has to say there, and how a number is written."""

    of: Callable[[Run], float]
    form: str


@dataclass(frozen=True)
class Comparison:
    """A target that trains variants and compares each with the first one.

    Attributes:
        name: as on the command line, and of its files.
        variants: what is trained, the baseline first.
        common: overrides of all.
        seeds: of the full scale.
        quick_common: overrides of the quick scale beside them.
        extra: columns of its own, by title.
        note: beneath the table.
    """

    name: str
    variants: Sequence[Variant]
    common: tuple[str, ...]
    seeds: tuple[int, ...]
    quick_common: tuple[str, ...] = ("train.episodes=150",)
    extra: Mapping[str, Column] = field(default_factory=dict)
    note: str = NOTE

    def cells(self, quick: bool) -> list[Cell]:
        """See ``Target``."""
        seeds = QUICK_SEEDS if quick else self.seeds
        common = (*self.common, *(self.quick_common if quick else ()))
        return [
            Cell(each.label, (*common, *each.overrides.split()), seeds)
            for each in self.variants
            if each is self.variants[0] or each.quick or not quick
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
        return [
            self._change(variant, runs[variant.label], baseline)
            for variant in self.variants
            if variant.label in runs
        ]

    def _change(
        self, variant: Variant, by_seed: Mapping[int, Run], baseline: Mapping[int, Run]
    ) -> Change:
        ours, theirs = ([each[seed] for seed in sorted(by_seed)] for each in (by_seed, baseline))
        times = statistics.times(ours, "episode")
        estimates = {key: estimate(last5(ours, key)) for key in MEASURES}
        for key in MEASURES:
            estimates[f"{key}_difference"] = difference(last5(ours, key), last5(theirs, key))
        estimates["converged_episode"] = statistics.converged(times)
        for title, column in self.extra.items():
            estimates[title] = estimate([column.of(run) for run in ours])
        return Change(variant, estimates, int((~times.censored).sum()))

    def _write_table(self, path: Path, changes: Sequence[Change]) -> Path:
        shown = {title: column.form for title, column in self.extra.items()}
        shown |= {key: MEASURES[key] for key in ("success", "path_ratio", "ee")}
        rows: list[Row] = []
        for change in changes:
            variant, found = change.variant, change.estimates
            when = found["converged_episode"]
            deltas = [
                found[f"{key}_difference"].text(f"+{MEASURES[key]}") for key in ("success", "ee")
            ]
            rows.append(
                (
                    variant.group,
                    variant.label if variant.name else f"`{variant.label}`",
                    *(found[key].text(form) for key, form in shown.items()),
                    f"{when.text('.0f')}, {change.there} of {when.seeds}",
                    *(("", "") if change is changes[0] else deltas),
                )
            )
        header = ("", "changed", *self.extra, "success", "path ratio", "EE", "converged")
        return write_table(path, (*header, "Δ success", "Δ EE"), rows, self.note)

    def _write_csv(self, path: Path, changes: Sequence[Change]) -> Path:
        header = ("group", "changed", "measure", *Estimate._fields)
        rows = [
            (change.variant.group, change.variant.label, key, *numbers)
            for change in changes
            for key, numbers in change.estimates.items()
        ]
        return write_csv(path, header, rows)

    def _write_runs(self, path: Path, runs: Runs) -> Path:
        """A row a run."""
        rows = []
        for name, by_seed in runs.items():
            for seed, run in by_seed.items():
                when = (run.summary["converged"] or {}).get("episode")
                values = [float(last5([run], key)[0]) for key in MEASURES]
                own = [float(column.of(run)) for column in self.extra.values()]
                rows.append((name, seed, *values, when, *own))
        header = ("changed", "seed", *MEASURES, "converged_episode", *self.extra)
        return write_csv(path, header, rows)


def last5(runs: Sequence[Run], measure: str) -> Floats:
    """A measure of each run, the mean over its last five evaluations; nan where nobody arrived."""
    found = [run.summary["evaluation"]["last5"][measure] for run in runs]
    return np.array([np.nan if value is None else value for value in found], float)
