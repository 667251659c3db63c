"""Fig. 4: energy efficiency against the power budget, for K, M_R, NOMA and OMA."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple, Protocol

from conf import Config, overridden
from experiments.reproduce.results.output import save_figure, write_csv
from experiments.reproduce.results.planning import planned_values
from experiments.reproduce.results.points import (
    BEST,
    LEARNED,
    PLANNED,
    PLANNED_AGAIN,
    Point,
    PointOutcome,
    points,
)
from experiments.reproduce.results.runs import Run, Runs
from experiments.reproduce.targets.fig4_drawing import draw
from experiments.reproduce.targets.fig4_tables import write_comparisons, write_points
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
        """Of its cell."""
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
        """Of its cell with ``experiment=best``."""
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


class Named(Protocol):
    """What is trained for a part of a figure."""

    @property
    def name(self) -> str:
        """Of its cell."""

    @property
    def overrides(self) -> tuple[str, ...]:
        """Hydra's."""


def cells_of(which: Sequence[Named], quick: bool) -> list[Cell]:
    """A cell for each part of a figure: three seeds, or a quick one."""
    seeds, shorter = (QUICK_SEEDS[:1], QUICK) if quick else (THREE_SEEDS, ())
    return [Cell(each.name, (*each.overrides, *shorter), seeds) for each in which]


def best_cells(which: Sequence[Fig4Setting], quick: bool) -> list[Cell]:
    """A cell of ``experiment=best`` for settings that have it, and seeds as in ``cells_of``."""
    seeds, shorter = (QUICK_SEEDS[:1], QUICK_BEST) if quick else (THREE_SEEDS, ())
    best = "experiment=best"
    own = [each for each in which if each.has_best]
    return [Cell(each.best, (best, *each.overrides, *shorter), seeds) for each in own]


class Fig4:
    """The target ``fig4``.

    A learned point is the mean of a run's last five evaluations: frozen weights on held-out starts
    with the exploration of evaluations, the protocol of docs/results.md. ``experiment=best``
    evaluates seldom while it trains, so its points are of the final weights. A planned one is the
    trajectory oracle on ``PLANNED_STARTS`` of each seed.

    Args:
        processes: that plan trajectories at once; the cores if None.
    """

    name = "fig4"

    def __init__(self, processes: int | None = None) -> None:
        self._processes = processes

    def cells(self, quick: bool) -> list[Cell]:
        """A cell for each point after those of ``experiment=best``; in full 60 and 10."""
        which = settings(quick)
        return [*best_cells(which, quick), *cells_of(which, quick)]

    def report(self, runs: Runs, out: Path, *, quick: bool) -> list[Path]:
        """Writes figure, what it draws, every seed's values, and tables of both.

        Args:
            runs: every run of ``cells``.
            out: an existing folder; planned values are kept in its ``planned.csv``.
            quick: whether the runs are those of a quick figure.

        Returns:
            The files written.
        """
        found = outcomes(runs, settings(quick), out / "planned.csv", self._processes)
        with_best = next(each for each in settings(quick) if each.has_best)
        drawn, note = points(found), _note(runs, with_best)
        return [
            *save_figure(draw(drawn, note), out, self.name, quick=quick),
            write_csv(out / "fig4.csv", Point._fields, drawn),
            write_csv(out / "fig4_runs.csv", PointOutcome._fields, found),
            write_comparisons(out / "fig4_comparisons.csv", found),
            write_points(out / "fig4.md", drawn, note.replace("\n", " ")),
            out / "planned.csv",
        ]


TARGET = Fig4()


def outcomes(
    runs: Runs, which: Sequence[Fig4Setting], file: Path, processes: int | None = None
) -> list[PointOutcome]:
    """What every run came to, and what is planned for its starts.

    Args:
        runs: every run of the settings.
        which: the settings.
        file: keeps planned values.
        processes: that plan at once.
    """
    trained = [(each, run) for each in which for run in runs[each.name].values()]
    plans = [(each, PLANNED, _fewer_starts(run.config)) for each, run in trained]
    plans += [
        (each, PLANNED_AGAIN, _reallocated(config))
        for each, _, config in plans
        if each.access == "oma"
    ]
    values = planned_values([config for *_, config in plans], file, processes)
    found = [_learned(each, run) for each, run in trained]
    found += [
        _best(each, run) for each in which if each.has_best for run in runs[each.best].values()
    ]
    for (each, curve, config), value in zip(plans, values, strict=True):
        found.append(
            PointOutcome(*each, curve, config.seed, value.ee, 1.0, value.sum_rate, value.min_rate)
        )
    return found


def _learned(setting: Fig4Setting, run: Run) -> PointOutcome:
    last, greedy = (run.summary["evaluation"][name] for name in ("last5", "last5_greedy"))
    return PointOutcome(
        *setting,
        LEARNED,
        run.seed,
        last["ee"],
        last["success"],
        last["sum_rate"],
        last["min_rate"],
        greedy["ee"],
        greedy["success"],
    )


def _best(setting: Fig4Setting, run: Run) -> PointOutcome:
    """The final weights of a run with ``experiment=best``."""
    of, greedy = (run.summary["evaluation"][name] for name in ("eps05", "greedy"))
    measures = of["ee"], of["success"], of["sum_rate"], of["min_rate"]
    return PointOutcome(*setting, BEST, run.seed, *measures, greedy["ee"], greedy["success"])


def _fewer_starts(config: Config) -> Config:
    """The same task with no more held-out starts than are planned for."""
    evaluation = config.evaluation
    fewer = dataclasses.replace(evaluation, episodes=min(evaluation.episodes, PLANNED_STARTS))
    return dataclasses.replace(config, evaluation=fewer)


def _reallocated(config: Config) -> Config:
    """The same task, where the part of a robot that has arrived goes to the others."""
    return overridden(config, ["env.oma.share=reallocate"])


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
