"""How near fleets come to the optimum: ``experiment=best``, its rivals with the same help, a rule.

Each run's final weights drive greedily from held-out starts, and count as shares of what the
trajectory oracle's plans reach from the same starts. Rivals get what ``experiment=best`` has: its
rewards, searched powers, as many worlds and ticks, the same learner. One agent for everything sees
the global state, in which no robot's way is and robots stand by index, as it acts for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from conf import overridden
from env.episode import EpisodeMeasures
from experiments.analysis.optimality_gap import shortest_best_measures
from experiments.reproduce.results.output import write_csv, write_table
from experiments.reproduce.results.planning import Planned, planned_values
from experiments.reproduce.results.runs import Runs
from experiments.reproduce.results.statistics import Estimate, difference, estimate
from experiments.reproduce.targets.plan import FRESH_SEEDS, Cell
from training.evaluation import Evaluator

ROBOTS = (2, 3, 4, 6)
STARTS = 16
"""Held-out starts of each seed that are played and planned."""

BEST = "best"
INDEPENDENT = "independent learners"
BRANCHING = "branching heads"
CENTRALIZED = "centralized"
PAPER = "the paper's settings"
RULE = "shortest ways, best phases and powers"

HELPED = {
    BEST: (),
    INDEPENDENT: ("baseline=independent",),
    BRANCHING: ("baseline=branching", "env.state.order=index"),
    CENTRALIZED: ("baseline=centralized", "env.state.order=index"),
}
"""What changes ``experiment=best`` into each learner that gets the same help."""

RIVALS_AT = (3,)
"""The K with which the rivals are trained, too; centralized DQN has 16,384 joint actions at six."""

QUICK_HELPED = (
    "train.max_ticks=600",
    "agent.epsilon.ticks=200",
    "agent.learning_rate_updates=600",
)
QUICK_PAPER = ("train.episodes=100", "agent.epsilon.ticks=4000")

MEASURES = {
    "success": ("success", ".3f", 1.0),
    "ee_share": ("(5a), % of the plans'", ".1f", 100.0),
    "bits_share": ("bit/J, % of the plans'", ".1f", 100.0),
    "path_ratio": ("path ratio", ".3f", 1.0),
    "cpu_s": ("CPU s", ".0f", 1.0),
}
"""Its column's title, how each is written, and times what."""

NOTE = (
    "Frozen final weights, greedy, from {starts} held-out starts of each seed; plans are the"
    " trajectory oracle's for the same starts, a lower bound on the best with several robots."
    " Interquartile means over seeds {seeds} with 95 % bootstrap intervals; the last column is"
    " paired by seed. CPU seconds are those of the run's process, evaluations included."
)


class OptimalityOutcome(NamedTuple):
    """What a learner, or the rule, came to with one seed.

    Attributes:
        robots: K.
        learner: or the rule.
        seed: the run's.
        success: share of the robots that arrive.
        ee: energy efficiency in bit/s/Hz/J, the objective (5a).
        ee_bits_per_joule: all bits over all energy, in bit/J.
        ee_share: of the plans'.
        bits_share: likewise, in bit/J.
        path_ratio: slots driven over the fewest possible, nan where nobody arrives.
        cpu_s: processor time of the run in s, nan of the rule.
    """

    robots: int
    learner: str
    seed: int
    success: float
    ee: float
    ee_bits_per_joule: float
    ee_share: float
    bits_share: float
    path_ratio: float
    cpu_s: float


class Optimality:
    """The target ``optimality``."""

    name = "optimality"

    def cells(self, quick: bool) -> list[Cell]:
        """See ``Target``: with each K all that learn, the paper's settings last."""
        helped, paper = (QUICK_HELPED, QUICK_PAPER) if quick else ((), ())
        seeds = FRESH_SEEDS[:1] if quick else FRESH_SEEDS
        cells = []
        for robots in RIVALS_AT if quick else ROBOTS:
            task = f"env.robots={robots}"
            cells += [
                Cell(named(learner, robots), ("experiment=best", *own, task, *helped), seeds)
                for learner, own in HELPED.items()
                if learner == BEST or robots in RIVALS_AT
            ]
            cells.append(Cell(named(PAPER, robots), (task, *paper), seeds))
        return cells

    def report(self, runs: Runs, out: Path, *, quick: bool) -> list[Path]:
        """See ``Target``."""
        found = outcomes(runs, out / "planned.csv")
        made = estimates(found)
        numbers = [(*of, key, *each[:4]) for of, by in made.items() for key, each in by.items()]
        header = ("robots", "learner", "measure", *Estimate._fields[:4])
        return [
            _write_table(out / "optimality.md", found, made, quick),
            write_csv(out / "optimality.csv", header, numbers),
            write_csv(out / "optimality_runs.csv", OptimalityOutcome._fields, found),
            out / "planned.csv",
        ]


TARGET = Optimality()


def named(learner: str, robots: int) -> str:
    """The name of a learner's cell."""
    return f"{learner}, K = {robots}"


def outcomes(runs: Runs, file: Path) -> list[OptimalityOutcome]:
    """What every run came to, and the rule from the same starts, as shares of the plans'.

    A file keeps planned values.
    """
    trained = [(name.split(",")[0], run) for name, each in runs.items() for run in each.values()]
    tasks = {(r.config.env.robots, r.seed): r.config for which, r in trained if which == BEST}
    of_starts = [overridden(c, [f"evaluation.episodes={STARTS}"]) for c in tasks.values()]
    values = planned_values(of_starts, file)
    plans = dict(zip(tasks, values, strict=True))
    found = []
    for learner, run in trained:
        task = run.config.env.robots, run.seed
        (measures,) = Evaluator(run.config, episodes=STARTS).play(*run.weights(), (0.0,))
        found.append(_outcome(*task, learner, measures, plans[task], run.summary["cpu_s"]))
    for task, config in tasks.items():
        measures = shortest_best_measures(Evaluator(config, episodes=STARTS))
        found.append(_outcome(*task, RULE, measures, plans[task], np.nan))
    return sorted(found, key=lambda each: each.robots)


def _outcome(
    robots: int, seed: int, learner: str, measures: EpisodeMeasures, plan: Planned, cpu_s: float
) -> OptimalityOutcome:
    found = measures.summary()
    ee, bits = found["ee"], found["ee_bits_per_joule"]
    shares = ee / plan.ee, bits / plan.ee_bits_per_joule
    ends = found["path_ratio"], cpu_s
    return OptimalityOutcome(robots, learner, seed, found["success"], ee, bits, *shares, *ends)


Estimates = dict[tuple[int, str], dict[str, Estimate]]
"""Of each K and learner every measure, and how far its (5a) is from that of ``best``."""


def estimates(found: Sequence[OptimalityOutcome]) -> Estimates:
    """Interquartile means over seeds with intervals, in the order of the outcomes."""
    groups: dict[tuple[int, str], dict[int, OptimalityOutcome]] = {}
    for each in found:
        groups.setdefault((each.robots, each.learner), {})[each.seed] = each
    made: Estimates = {}
    for (robots, learner), ours in groups.items():
        measured = {name: estimate([getattr(o, name) for o in ours.values()]) for name in MEASURES}
        best = groups[robots, BEST]
        shares = [(each.ee_share, best[seed].ee_share) for seed, each in ours.items()]
        measured["above_best"] = difference(*zip(*shares, strict=True))
        made[robots, learner] = measured
    return made


def _write_table(
    path: Path, found: Sequence[OptimalityOutcome], made: Estimates, quick: bool
) -> Path:
    rows = []
    for (robots, learner), measured in made.items():
        cells = [measured[key].text(form, scale) for key, (_, form, scale) in MEASURES.items()]
        above = "" if learner == BEST else measured["above_best"].text("+.1f", 100.0)
        rows.append((robots, learner, *cells, above))
    seeds = ", ".join(map(str, sorted({each.seed for each in found})))
    note = NOTE.format(starts=STARTS, seeds=seeds)
    titles = (title for title, *_ in MEASURES.values())
    header = ("K", "learner", *titles, "(5a), points above best")
    return write_table(path, header, rows, note, quick=quick)
