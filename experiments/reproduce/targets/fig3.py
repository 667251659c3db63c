"""Fig. 3: total reward against episode, and who converges when.

The paper's curves, F-DRL with K robots beside centralized DQN with two, and a rival that it does
not have: centralized DQN with branching heads.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.reproduce.results import statistics
from experiments.reproduce.results.output import plain, save_figure, write_csv, write_table
from experiments.reproduce.results.runs import Run, Runs
from experiments.reproduce.results.statistics import UNITS, Estimate, Floats, estimate
from experiments.reproduce.targets.comparison import last5
from experiments.reproduce.targets.plan import QUICK_SEEDS, SEEDS, Cell
from training.recording.figures import running_mean
from training.recording.history import CONVERGED

SMOOTHING = 20
"""Episodes over which drawn rewards are averaged."""

FEDERATED = "F-DRL, K = {}"
CENTRALIZED = "centralized, K = 2"
BRANCHING = "branching heads, K = 2"
RIVALS = (CENTRALIZED, BRANCHING)
OURS = FEDERATED.format(2)
TUNED: dict[str, tuple[str, ...]] = {CENTRALIZED: (), BRANCHING: ()}
"""What the rivals' tuning chose above the default (docs/reproduction.md)."""

COLOURS = {
    FEDERATED.format(2): "#2e86de",
    FEDERATED.format(3): "#10ac84",
    FEDERATED.format(4): "#8854d0",
    FEDERATED.format(5): "#e67e22",
    FEDERATED.format(6): "#7f8c8d",
    CENTRALIZED: "#e4572e",
    BRANCHING: "#222f3e",
}
NOTE = (
    "Interquartile means over seeds with 95 % bootstrap intervals; converged is the first of three"
    " evaluations in a row with success of at least .9. CPU seconds are those of the run's"
    " process, which trained one seed at a time, evaluations included. ≥ and ≤ mark bounds: a run"
    " that had not converged when it ended counts as its length."
)


class Curve(NamedTuple):
    """A mean over seeds and its interval.

    Attributes:
        episode: where, shape (points,).
        mean: of the seeds, and ``low`` and ``high`` the ends of its interval, shape (points,).
    """

    episode: Floats
    mean: Floats
    low: Floats
    high: Floats


Estimates = dict[str, dict[str, Estimate]]
"""Of each name an estimate in each of ``UNITS``."""


class Fig3:
    """See the module."""

    name = "fig3"

    def cells(self, quick: bool) -> list[Cell]:
        """See ``Target``."""
        seeds, episodes, longer = (QUICK_SEEDS, 150, 250) if quick else (SEEDS, 300, 600)
        end = f"train.episodes={episodes}"
        cells = [
            Cell(FEDERATED.format(k), (f"env.robots={k}", end), seeds)
            for k in ((2, 3, 4) if quick else (2, 3, 4, 5, 6))
        ]
        for name, baseline, its_end in (
            (CENTRALIZED, "centralized", f"train.episodes={longer}"),
            (BRANCHING, "branching", end),
        ):
            own = (f"baseline={baseline}", "env.robots=2", its_end, *TUNED[name])
            cells.append(Cell(name, own, seeds))
        return cells

    def report(self, runs: Runs, out: Path, *, quick: bool) -> list[Path]:
        """See ``Target``."""
        each = {name: [by_seed[s] for s in sorted(by_seed)] for name, by_seed in runs.items()}
        rewards = {name: reward_curve(found) for name, found in each.items()}
        successes = {name: success_curve(found) for name, found in each.items()}
        figure = _draw(rewards, successes, len(next(iter(each.values()))))
        converged = {
            name: {unit: statistics.converged(statistics.times(found, unit)) for unit in UNITS}
            for name, found in each.items()
        }
        reduced = {rival: reductions(each[OURS], each[rival]) for rival in RIVALS}
        return [
            *save_figure(figure, out, self.name, quick=quick),
            _write_curves(out / "fig3.csv", rewards),
            _write_curves(out / "fig3_success.csv", successes),
            _write_runs(out / "fig3_runs.csv", each),
            _write_convergence(out / "fig3_convergence.md", each, converged),
            _write_reductions(out / "fig3_reductions.md", reduced),
            _write_estimates(out / "fig3_convergence.csv", converged),
            _write_estimates(out / "fig3_reductions.csv", reduced),
        ]


TARGET = Fig3()


def reward_curve(runs: Sequence[Run]) -> Curve:
    """Total reward of training episodes, the mean of the last ``SMOOTHING``."""
    return _curve([running_mean(run.metrics()["reward"], SMOOTHING) for run in runs], 1)


def success_curve(runs: Sequence[Run]) -> Curve:
    """Success of frozen weights with exploration, evaluation by evaluation."""
    every = runs[0].config.evaluation.every
    return _curve([run.evaluations()["success"] for run in runs], every)


def _curve(curves: Sequence[Floats], every: int) -> Curve:
    """Curves of several seeds as one; the window at a run's end may hold an episode more."""
    length = min(map(len, curves))
    episode = every * np.arange(1.0, length + 1)
    return Curve(episode, *statistics.mean_band(np.stack([curve[:length] for curve in curves])))


def _draw(rewards: dict[str, Curve], successes: dict[str, Curve], seeds: int) -> Figure:
    figure = Figure(figsize=(11, 7), layout="constrained")
    rows = figure.subplots(2, 2, sharey="row", sharex="col")
    federated = [name for name in rewards if name not in RIVALS]
    columns = {"K = 2: F-DRL and its rivals": (OURS, *RIVALS), "F-DRL: K robots": federated}
    for column, (title, names) in enumerate(columns.items()):
        for axes, curves in zip(rows[:, column], (rewards, successes), strict=True):
            for name in names:
                _draw_curve(axes, name, curves[name])
            plain(axes)
        rows[0, column].set_title(title)
        rows[0, column].legend(loc="lower right", frameon=False, fontsize=9)
        rows[1, column].axhline(CONVERGED, color="#999999", linewidth=0.8, linestyle="--")
        rows[1, column].set(xlabel="training episode", ylim=(-0.02, 1.05))
    rows[0, 0].set_ylabel(f"total reward of a training episode\n(mean of the last {SMOOTHING})")
    rows[1, 0].set_ylabel("robots that arrive\n(frozen weights, held-out starts, eps = .05)")
    figure.suptitle(f"mean of {seeds} seeds, 95 % bootstrap interval", fontsize=9)
    return figure


def _draw_curve(axes: Axes, name: str, curve: Curve) -> None:
    colour = COLOURS[name]
    axes.fill_between(curve.episode, curve.low, curve.high, color=colour, alpha=0.15, linewidth=0)
    axes.plot(curve.episode, curve.mean, color=colour, linewidth=1.5, label=name)


def reductions(ours: Sequence[Run], theirs: Sequence[Run]) -> dict[str, Estimate]:
    """How much less ours take until they converge, as a share, in each of ``UNITS``."""
    return {
        unit: statistics.reduction(*(statistics.times(runs, unit) for runs in (ours, theirs)))
        for unit in UNITS
    }


def _write_curves(path: Path, curves: dict[str, Curve]) -> Path:
    rows = [
        (name, int(episode), *map(float, band))
        for name, curve in curves.items()
        for episode, *band in zip(*curve, strict=True)
    ]
    return write_csv(path, ("cell", *Curve._fields), rows)


def _write_runs(path: Path, each: dict[str, list[Run]]) -> Path:
    """A row a run: when it converged, empty where it did not, and what it came to."""
    header = ("cell", "seed", *UNITS, "success", "greedy", "path_ratio", "ee", "cpu_s_whole")
    rows = []
    for name, runs in each.items():
        for run in runs:
            found, last = run.summary["converged"] or {}, run.summary["evaluation"]
            success, path_ratio, ee = (last["last5"][k] for k in ("success", "path_ratio", "ee"))
            measures = success, last["last5_greedy"]["success"], path_ratio, ee
            times = [found.get(unit) for unit in UNITS]
            rows.append((name, run.seed, *times, *measures, run.summary["cpu_s"]))
    return write_csv(path, header, rows)


def _write_convergence(path: Path, each: dict[str, list[Run]], converged: Estimates) -> Path:
    rows = []
    for name, runs in each.items():
        there = sum(run.summary["converged"] is not None for run in runs)
        success = estimate(last5(runs, "success"))
        cells = [found.text(".0f") for found in converged[name].values()]
        rows.append((name, f"{there} of {len(runs)}", *cells, success.text(".2f")))
    header = ("", "converged", *UNITS.values(), "success, last five evaluations")
    return write_table(path, header, rows, NOTE)


def _write_reductions(path: Path, reduced: Estimates) -> Path:
    rows = [
        (f"{OURS}, against {rival}", *(found.text(".0f", 100.0) for found in by_unit.values()))
        for rival, by_unit in reduced.items()
    ]
    header = ("less, in %", *UNITS.values())
    return write_table(path, header, rows, NOTE + " Below zero: ours takes longer.")


def _write_estimates(path: Path, estimates: Estimates) -> Path:
    """A table as numbers."""
    rows = [
        (name, unit, *numbers)
        for name, by_unit in estimates.items()
        for unit, numbers in by_unit.items()
    ]
    return write_csv(path, ("", "unit", *Estimate._fields), rows)
