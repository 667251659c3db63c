"""Fig. 4: energy efficiency against the power budget, for K, M_R, NOMA and OMA."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

from conf import overridden
from experiments.reproduce.results.output import save_figure, write_csv
from experiments.reproduce.results.planning import planned_values
from experiments.reproduce.results.runs import Run, Runs
from experiments.reproduce.targets.fig4_drawing import draw
from experiments.reproduce.targets.fig4_points import (
    BEST,
    LEARNED,
    PLANNED,
    PLANNED_AGAIN,
    Neighbour,
    Point,
    PointOutcome,
    neighbours,
    points,
    write_points,
)
from experiments.reproduce.targets.plan import QUICK_SEEDS, THREE_SEEDS, Cell

POWERS_DBM = (10, 15, 20, 25, 30)
ROBOTS = (3, 4)
SIDES = (0, 20, 30)
ACCESSES = ("noma", "oma")

PLANNED_STARTS = 15
"""Of each seed and point: a plan for K = 4 takes a second, and the full figure needs 270 values."""

QUICK_POWERS_DBM = (10, 20, 30)
QUICK_ROBOTS = (3,)
QUICK_SIDES = (0, 30)
QUICK = ("train.episodes=150", "agent.epsilon.ticks=5000", "evaluation.episodes=20")
"""Half of the training, explored in half the time, and fewer starts to play and to plan."""

QUICK_BEST = (
    "train.max_ticks=1000",
    "agent.epsilon.ticks=300",
    "agent.learning_rate_updates=1000",
    "evaluation.episodes=20",
)
"""Of ``experiment=best``: a sixth of its training, and as few starts."""


class Fig4Setting(NamedTuple):
    """A point of the figure.

    Attributes:
        robots: K.
        side: M_R.
        max_dbm: P_max in dBm.
        access: noma or oma (Baseline 2, whose parts stay fixed).
    """

    robots: int
    side: int
    max_dbm: int
    access: str

    @property
    def name(self) -> str:
        """Its cell's."""
        return f"k{self.robots}-side{self.side}-{self.max_dbm}dbm-{self.access}"

    @property
    def overrides(self) -> tuple[str, ...]:
        """Hydra's."""
        return (
            f"env.robots={self.robots}",
            f"env.ris.side={self.side}",
            f"env.power.max_dbm={self.max_dbm}",
            f"env.access={self.access}",
        )

    @property
    def best(self) -> str:
        """The name of its cell with ``experiment=best``."""
        return f"{self.name}-best"

    @property
    def has_best(self) -> bool:
        """Whether there is one: a run takes a minute, so with one K and one surface."""
        return (self.robots, self.side) == (ROBOTS[0], SIDES[-1])


def settings(quick: bool) -> list[Fig4Setting]:
    """All points of the figure."""
    full = (ROBOTS, SIDES, POWERS_DBM)
    robots, sides, powers_dbm = (QUICK_ROBOTS, QUICK_SIDES, QUICK_POWERS_DBM) if quick else full
    return [Fig4Setting(*each) for each in product(robots, sides, powers_dbm, ACCESSES)]


def cells_of(
    settings: Mapping[str, Sequence[str]], quick: bool, shorter: Sequence[str] = QUICK
) -> list[Cell]:
    """A cell for each setting's name and overrides: three seeds, or one that is ``shorter``."""
    seeds = QUICK_SEEDS[:1] if quick else THREE_SEEDS
    return [
        Cell(name, (*overrides, *(shorter if quick else ())), seeds)
        for name, overrides in settings.items()
    ]


class Fig4:
    """The target ``fig4``.

    A learned point is the mean of a run's last five evaluations: frozen weights on held-out starts
    with the exploration of evaluations, the protocol of docs/results.md. ``experiment=best``
    evaluates seldom while it trains, so its points are of the final weights. A planned one is the
    trajectory oracle on ``PLANNED_STARTS`` of each seed.
    """

    name = "fig4"

    def cells(self, quick: bool) -> list[Cell]:
        """A cell for each point after those of ``experiment=best``; in full 60 and 10."""
        which = settings(quick)
        best = {each.best: ("experiment=best", *each.overrides) for each in which if each.has_best}
        plain = {each.name: each.overrides for each in which}
        return [*cells_of(best, quick, QUICK_BEST), *cells_of(plain, quick)]

    def report(self, runs: Runs, out: Path, *, quick: bool) -> list[Path]:
        """Writes figure, what it draws, every seed's values, and tables of both."""
        found = outcomes(runs, settings(quick), out / "planned.csv")
        with_best = next(each for each in settings(quick) if each.has_best)
        drawn, note = points(found), _note(runs, with_best)
        return [
            *save_figure(draw(drawn, note), out, self.name, quick=quick),
            write_csv(out / "fig4.csv", Point._fields, drawn),
            write_csv(out / "fig4_runs.csv", PointOutcome._fields, found),
            write_csv(out / "fig4_comparisons.csv", Neighbour._fields, neighbours(found)),
            write_points(out / "fig4.md", drawn, note.replace("\n", " ")),
            out / "planned.csv",
        ]


TARGET = Fig4()


def outcomes(runs: Runs, which: Sequence[Fig4Setting], file: Path) -> list[PointOutcome]:
    """What every run of the settings came to, and plans for its starts, kept in a file."""
    trained = [(each, run) for each in which for run in runs[each.name].values()]
    best = [(each, run) for each in which if each.has_best for run in runs[each.best].values()]
    plans = []
    for each, run in trained:
        starts = min(run.config.evaluation.episodes, PLANNED_STARTS)
        config = overridden(run.config, [f"evaluation.episodes={starts}"])
        plans.append((each, PLANNED, config))
    plans += [
        (each, PLANNED_AGAIN, overridden(config, ["env.oma.share=reallocate"]))
        for each, _, config in plans
        if each.access == "oma"
    ]
    values = planned_values([config for *_, config in plans], file)
    found = [_learned(each, LEARNED, run, ("last5", "last5_greedy")) for each, run in trained]
    found += [_learned(each, BEST, run, ("eps05", "greedy")) for each, run in best]
    for (each, curve, config), value in zip(plans, values, strict=True):
        found.append(
            PointOutcome(*each, curve, config.seed, value.ee, 1.0, value.sum_rate, value.min_rate)
        )
    return found


def _learned(
    setting: Fig4Setting, curve: str, run: Run, evaluations: tuple[str, str]
) -> PointOutcome:
    """What a run came to in two of its summary's evaluations, with exploration and greedy."""
    explored, greedy = (run.summary["evaluation"][name] for name in evaluations)
    measures = [explored[name] for name in ("ee", "success", "sum_rate", "min_rate")]
    ends = {f"greedy_{name}": greedy[name] for name in ("ee", "success")}
    return PointOutcome(*setting, curve, run.seed, *measures, **ends)


def _note(runs: Runs, setting: Fig4Setting) -> str:
    """What the figure says below itself; a setting with ``experiment=best`` stands for all."""
    some = runs[setting.name]
    run = next(iter(some.values()))
    best = next(iter(runs[setting.best].values()))
    evaluation, seeds = run.config.evaluation, ", ".join(map(str, sorted(some)))
    over = f"mean and 95 % bootstrap interval over seeds {seeds}"
    lines = [
        f"Learned: {run.config.train.episodes} episodes of training; frozen weights on"
        f" {evaluation.episodes} held-out starts of each seed,"
        f" eps = {evaluation.epsilon:g}, mean of the last five evaluations;"
        f" {over if len(some) > 1 else f'seed {seeds}'}.",
        f"Learned, best: experiment=best, {best.config.train.max_ticks} ticks in"
        f" {best.config.train.worlds} worlds; its final weights from the same starts.",
        f"Planned: the trajectory oracle from {min(evaluation.episodes, PLANNED_STARTS)} held-out"
        " starts of each seed, on which all robots arrive (a lower bound on the best).",
    ]
    return "\n".join(lines)
