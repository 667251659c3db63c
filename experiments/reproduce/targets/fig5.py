"""Fig. 5: where robots drive for M_R = 0, 20, 30, 40, with QoS and QoE, learned and planned."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

from experiments.analysis.played import learned, mirrored, planned
from experiments.reproduce.results.output import Row, save_figure, write_csv
from experiments.reproduce.results.planning import planned_values
from experiments.reproduce.results.runs import Run, Runs
from experiments.reproduce.targets.fig4 import cells_of
from experiments.reproduce.targets.fig4_points import LEARNED, PLANNED
from experiments.reproduce.targets.fig5_drawing import Shown, draw_along, draw_ways
from experiments.reproduce.targets.plan import Cell
from training.evaluation import Evaluator

SIDES = (0, 20, 30, 40)
QUICK_SIDES = (0, 30)
METRICS = ("qos", "qoe")
ROBOTS = 3
GREEDY = 0.0
ONE_START, HELD_OUT = "the figure's", "held out"


class Fig5Setting(NamedTuple):
    """A panel's part.

    Attributes:
        side: M_R.
        metric: what rewards count: qos, or qoe (Baseline 3).
    """

    side: int
    metric: str

    @property
    def name(self) -> str:
        """Of its cell."""
        return f"side{self.side}-{self.metric}"

    @property
    def overrides(self) -> tuple[str, ...]:
        """Hydra's."""
        return f"env.robots={ROBOTS}", f"env.ris.side={self.side}", f"env.metric={self.metric}"


class Fig5Measures(NamedTuple):
    """Measures of one run or plan.

    Attributes:
        side: M_R.
        metric: qos or qoe.
        policy: learned or planned.
        starts: the figure's, or held out.
        seed: None of the plan that is drawn.
        ee: with the other measures as in ``planning.Planned``.
        success: share of the robots that arrive.
    """

    side: int
    metric: str
    policy: str
    starts: str
    seed: int | None
    ee: float
    sum_rate: float
    min_rate: float
    success: float
    path_ratio: float
    gain_db: float


SLOT = ("side", "metric", "seed", "policy", "robot", "slot", "x_m", "y_m", "gain_db", "rate")
"""Columns of ``fig5.csv``."""


def settings(quick: bool) -> list[Fig5Setting]:
    """All parts of the figure."""
    return [Fig5Setting(*each) for each in product(QUICK_SIDES if quick else SIDES, METRICS)]


class Fig5:
    """The target ``fig5``.

    One episode is drawn, each robot starting opposite its destination (``along.mirrored``): of the
    first seed's greedy policy, and of the plan that the trajectory oracle makes for it. What holds
    on average is in ``fig5_measures.csv``, of all seeds and of their held-out starts.
    """

    name = "fig5"

    def cells(self, quick: bool) -> list[Cell]:
        """A cell for each M_R and metric; at full size three seeds of 8, 24 runs."""
        return cells_of({each.name: each.overrides for each in settings(quick)}, quick)

    def report(self, runs: Runs, out: Path, *, quick: bool) -> list[Path]:
        """Writes the ways, what robots are served along them, and the measures."""
        which = settings(quick)
        shown = [drawn for each in which for drawn in _shown(each, runs[each.name])]
        measures = [_measures(each) for each in shown]
        measures += held_out(runs, which, out / "planned.csv")
        files = [
            write_csv(out / "fig5.csv", SLOT, [row for each in shown for row in _slots(each)]),
            write_csv(out / "fig5_measures.csv", Fig5Measures._fields, measures),
            out / "planned.csv",
        ]
        run = first(runs[which[0].name])
        for name, seed, note in zip(
            ("fig5", "fig5_planned"), (run.seed, None), _notes(run), strict=True
        ):
            drawn = [each for each in shown if each.seed == seed]
            files += save_figure(draw_ways(drawn, note), out, name, quick=quick)
            files += save_figure(draw_along(drawn, note), out, f"{name}_along", quick=quick)
        return files


TARGET = Fig5()


def first(by_seed: Mapping[int, Run]) -> Run:
    """The run of the least seed, which is the one that is drawn."""
    return by_seed[min(by_seed)]


def _shown(setting: Fig5Setting, by_seed: Mapping[int, Run]) -> Iterator[Shown]:
    """The drawn episode by each seed's greedy policy, the least seed first, and as planned."""
    for seed in sorted(by_seed):
        run = by_seed[seed]
        yield Shown(*setting, LEARNED, seed, learned(mirrored(run.config), run.weights(), GREEDY))
    yield Shown(*setting, PLANNED, None, planned(mirrored(first(by_seed).config)))


def held_out(runs: Runs, which: Sequence[Fig5Setting], file: Path) -> list[Fig5Measures]:
    """Measures on every run's held-out starts: learned, and planned, which a file keeps.

    Learned ones are means of the last five evaluations, except for the gain along the ways, which
    is that of the final weights.
    """
    trained = [(each, run) for each in which for run in runs[each.name].values()]
    values = planned_values([run.config for _, run in trained], file)
    rows = []
    for (each, run), value in zip(trained, values, strict=True):
        drive = learned(Evaluator(run.config), run.weights(), run.config.evaluation.epsilon)
        last = {**run.summary["evaluation"]["last5"], "gain_db": drive.gain_db}
        rows.append(_row((*each, LEARNED, HELD_OUT, run.seed), last))
        rows.append(_row((*each, PLANNED, HELD_OUT, run.seed), value._asdict() | {"success": 1.0}))
    return rows


def _measures(shown: Shown) -> Fig5Measures:
    """Measures of an episode that the figure shows."""
    found = shown.drive.measures.summary() | {"gain_db": shown.drive.gain_db}
    return _row((shown.side, shown.metric, shown.policy, ONE_START, shown.seed), found)


def _row(of: tuple[int, str, str, str, int | None], found: Mapping[str, float]) -> Fig5Measures:
    return Fig5Measures(*of, *(found[name] for name in Fig5Measures._fields[len(of) :]))


def _slots(shown: Shown) -> Iterator[Row]:
    """A row for each slot of each robot that drives in it, by ``SLOT``; plans are of no seed."""
    drive = shown.drive
    ways_m, gain_db, rate = drive.ways_m[:, 0], drive.along.gain_db[:, 0], drive.along.rate[:, 0]
    for robot in range(gain_db.shape[1]):
        for slot in range(len(gain_db)):
            if drive.along.driving[slot][0, robot]:
                gain = round(float(gain_db[slot, robot]), 3)
                served = round(float(rate[slot, robot]), 4)
                of = shown.side, shown.metric, shown.seed, shown.policy, robot, slot
                yield *of, *ways_m[slot, robot], gain, served


def _notes(run: Run) -> tuple[str, str]:
    """What the figures say below themselves: the learned ones, and the planned ones."""
    starts = "Each robot starts opposite its destination, the room turned half round."
    learned_by = f"Frozen policy of seed {run.seed}, {run.config.train.episodes} episodes, greedy."
    return f"{learned_by} {starts}", f"Plans of the trajectory oracle for R_k and eta_k. {starts}"
