"""Fig. 5: where robots drive for M_R = 0, 20, 30, 40, with QoS and QoE, learned and planned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

from experiments.analysis.played import PlayedEpisodes, learned, mirrored, planned
from experiments.reproduce.results.output import save_figure, write_csv
from experiments.reproduce.results.planning import planned_values
from experiments.reproduce.results.points import LEARNED, PLANNED
from experiments.reproduce.results.runs import Run, Runs
from experiments.reproduce.targets.fig4 import cells_of
from experiments.reproduce.targets.fig5_drawing import Shown, draw_along, draw_ways
from experiments.reproduce.targets.plan import Cell
from training.evaluation import Evaluator

SIDES = (0, 20, 30, 40)
QUICK_SIDES = (0, 30)
METRICS = ("qos", "qoe")
ROBOTS = 3
GREEDY = 0.0
ONE_START, HELD_OUT = "the figure's", "held out"

Values = dict[str, object]


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


def settings(quick: bool) -> list[Fig5Setting]:
    """All parts of the figure."""
    return [Fig5Setting(*each) for each in product(QUICK_SIDES if quick else SIDES, METRICS)]


class Fig5:
    """The target ``fig5``.

    One episode is drawn, each robot starting opposite its destination (``along.mirrored``): of the
    first seed's greedy policy, and of the plan that the trajectory oracle makes for it. What holds
    on average is in ``fig5_measures.csv``, of all seeds and of their held-out starts.

    Args:
        processes: that plan trajectories at once; the cores if None.
    """

    name = "fig5"

    def __init__(self, processes: int | None = None) -> None:
        self._processes = processes

    def cells(self, quick: bool) -> list[Cell]:
        """A cell for each M_R and metric; at full size three seeds of 8, 24 runs."""
        return cells_of(settings(quick), quick)

    def report(self, runs: Runs, out: Path, *, quick: bool) -> list[Path]:
        """Writes the ways, what robots are served along them, and the measures.

        Args:
            runs: every run of ``cells``.
            out: an existing folder; planned values are kept in its ``planned.csv``.
            quick: whether the runs are those of a quick figure.

        Returns:
            The files written.
        """
        which = settings(quick)
        drives = {each: _learned(runs[each.name]) for each in which}
        plans = {each: planned(mirrored(first(runs[each.name]).config)) for each in which}
        measures = _on_the_figure(drives, plans)
        measures += held_out(runs, which, out / "planned.csv", self._processes)
        files = [
            _write(out / "fig5.csv", _slots(drives, plans)),
            _write(out / "fig5_measures.csv", measures),
            out / "planned.csv",
        ]
        drawn = [Shown(*each, next(iter(by_seed.values()))) for each, by_seed in drives.items()]
        of_plans = [Shown(*each, drive) for each, drive in plans.items()]
        notes = _notes(first(runs[which[0].name]))
        names = "fig5", "fig5_planned"
        for name, shown, say in zip(names, (drawn, of_plans), notes, strict=True):
            files += save_figure(draw_ways(shown, say), out, name, quick=quick)
            files += save_figure(draw_along(shown, say), out, f"{name}_along", quick=quick)
        return files


TARGET = Fig5()


def first(by_seed: Mapping[int, Run]) -> Run:
    """The run of the least seed, which is the one that is drawn."""
    return by_seed[min(by_seed)]


def _learned(by_seed: Mapping[int, Run]) -> dict[int, PlayedEpisodes]:
    """The drawn episode as each seed's greedy policy drives it, the least seed first."""
    return {
        seed: learned(mirrored(by_seed[seed].config), by_seed[seed].weights(), GREEDY)
        for seed in sorted(by_seed)
    }


def held_out(
    runs: Runs, which: Sequence[Fig5Setting], file: Path, processes: int | None = None
) -> list[Values]:
    """Measures on every run's held-out starts: learned, and planned from the same starts.

    Learned ones are means of the last five evaluations, except for the gain along the ways, which
    is that of the final weights.

    Args:
        runs: every run of the settings.
        which: the settings.
        file: keeps planned values.
        processes: that plan at once.
    """
    trained = [(each, run) for each in which for run in runs[each.name].values()]
    values = planned_values([run.config for _, run in trained], file, processes)
    rows = []
    for (each, run), value in zip(trained, values, strict=True):
        last = run.summary["evaluation"]["last5"]
        drive = learned(Evaluator(run.config), run.weights(), run.config.evaluation.epsilon)
        rows.append(_row(each, LEARNED, HELD_OUT, run.seed, last, drive.gain_db))
        of_plan = {**vars(value), "success": 1.0}
        rows.append(_row(each, PLANNED, HELD_OUT, run.seed, of_plan, value.gain_db))
    return rows


def _on_the_figure(
    drives: Mapping[Fig5Setting, Mapping[int, PlayedEpisodes]],
    plans: Mapping[Fig5Setting, PlayedEpisodes],
) -> list[Values]:
    """Measures of the one episode that the figure shows."""
    rows = []
    for each, by_seed in drives.items():
        shown = [(LEARNED, seed, drive) for seed, drive in by_seed.items()]
        for policy, seed, drive in [*shown, (PLANNED, None, plans[each])]:
            found = drive.measures.summary()
            rows.append(_row(each, policy, ONE_START, seed, found, drive.gain_db))
    return rows


def _row(
    setting: Fig5Setting,
    policy: str,
    starts: str,
    seed: int | None,
    found: Mapping[str, float],
    gain_db: float,
) -> Values:
    names = ("ee", "sum_rate", "min_rate", "success", "path_ratio")
    of = {**setting._asdict(), "policy": policy, "starts": starts, "seed": seed}
    return {**of, **{name: found[name] for name in names}, "gain_db": gain_db}


def _slots(
    drives: Mapping[Fig5Setting, Mapping[int, PlayedEpisodes]],
    plans: Mapping[Fig5Setting, PlayedEpisodes],
) -> list[Values]:
    """A row for each slot of each robot that drives in it; plans are of no seed."""
    rows: list[Values] = []
    for each, by_seed in drives.items():
        for seed, drive in by_seed.items():
            rows += [{**each._asdict(), "seed": seed, **slot} for slot in _along(LEARNED, drive)]
        rows += [{**each._asdict(), "seed": None, **slot} for slot in _along(PLANNED, plans[each])]
    return rows


def _along(policy: str, drive: PlayedEpisodes) -> list[Values]:
    ways_m, gain_db, rate = drive.ways_m[:, 0], drive.along.gain_db[:, 0], drive.along.rate[:, 0]
    return [
        {
            "policy": policy,
            "robot": robot,
            "slot": slot,
            "x_m": ways_m[slot, robot, 0],
            "y_m": ways_m[slot, robot, 1],
            "gain_db": round(float(gain_db[slot, robot]), 3),
            "rate": round(float(rate[slot, robot]), 4),
        }
        for robot in range(gain_db.shape[1])
        for slot in range(len(gain_db))
        if drive.along.driving[slot][0, robot]
    ]


def _notes(run: Run) -> tuple[str, str]:
    """What the figures say below themselves: the learned ones, and the planned ones."""
    starts = "Each robot starts opposite its destination, the room turned half round."
    learned_by = f"Frozen policy of seed {run.seed}, {run.config.train.episodes} episodes, greedy."
    return f"{learned_by} {starts}", f"Plans of the trajectory oracle for R_k and eta_k. {starts}"


def _write(file: Path, rows: Sequence[Values]) -> Path:
    return write_csv(file, list(rows[0]), [list(row.values()) for row in rows])
