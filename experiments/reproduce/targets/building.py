"""What more rooms bring to rooms that nobody trained in: ``experiment=building``, R = 1 to 64.

Each seed has sixteen held-out rooms, the same ones for every R. Weights drive there greedily, as
they come and after some local learning, beside the rule that knows all channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from conf import Config, ap_network, robot_network
from conf.rooms import Room
from experiments.analysis.optimality_gap import shortest_best_measures
from experiments.analysis.rooms import of_room
from experiments.reproduce.results.output import plain, save_figure, write_csv, write_table
from experiments.reproduce.results.runs import Run, Runs
from experiments.reproduce.results.statistics import Estimate, estimate
from experiments.reproduce.targets.plan import Cell
from training.evaluation import Evaluator
from training.recording.history import mean
from training.rooms import known_rooms

SEEDS = (50, 51, 52)
"""Those of ``experiment=building`` were 0 and 1."""
COUNTS = (1, 4, 16, 64)
HELD_OUT = 16
TICKS = 1200
ADAPTED = 240
"""Ticks of local learning in a held-out room."""

ROOMS = "R = {}"
LONGER = "R = 4, as many steps in all as R = 16"

NOTE = (
    "Frozen final weights, greedy, in {held_out} held-out rooms and in at most as many of those"
    " trained in, 50 held-out starts each; EE is objective (5a), and the rule drives shortest ways"
    " with the best phases and powers for the room's true channels. Interquartile means over seeds"
    " {seeds} with 95 % bootstrap intervals. Joint steps are those of all worlds of all rooms; MB"
    " are the weights that rooms send and receive in their averages; CPU seconds are of the"
    " training run with its evaluations, local learning apart."
)
MEASURES = {
    "success": ("success, held-out", ".3f", 1.0),
    "ee_share": ("EE there, % of the rule's", ".1f", 100.0),
    "adapted_success": (f"after {ADAPTED} ticks there: success", ".3f", 1.0),
    "adapted_share": ("EE, %", ".1f", 100.0),
    "trained_success": ("success, trained in", ".3f", 1.0),
    "trained_share": ("EE there, %", ".1f", 100.0),
    "steps": ("joint steps, 1000", ".0f", 1e-3),
    "megabytes": ("between rooms, MB", ".1f", 1.0),
    "cpu_s": ("CPU s", ".0f", 1.0),
}
"""What a run comes to: its column's title, how each is written, and times what.

Success is the share of the robots that arrive; shares are of the rule's energy efficiency (5a);
steps are joint ones, of all worlds in all rooms.
"""

Estimates = dict[str, dict[str, Estimate]]
"""Of each cell every measure."""


class Building:
    """The target ``building``."""

    name = "building"

    def cells(self, quick: bool) -> list[Cell]:
        """See ``Target``."""
        seeds = SEEDS[:1] if quick else SEEDS
        counts = COUNTS[:2] if quick else COUNTS
        short = _ticks(300) if quick else ()
        cells = [_cell(ROOMS.format(count), count, seeds, *short) for count in counts]
        if quick:
            return cells
        others = (
            (LONGER, 4, _ticks(4 * TICKS)),
            ("R = 16, access points not averaged", 16, ("rooms.access_points=own",)),
            ("R = 16, a third of the rooms missing in each round", 16, ("rooms.fraction=0.6667",)),
            ("R = 64, the default plan, map seeds apart", 64, ("rooms.plans=[]",)),
        )
        return cells + [_cell(name, count, seeds, *changes) for name, count, changes in others]

    def report(self, runs: Runs, out: Path, *, quick: bool) -> list[Path]:
        """See ``Target``."""
        found = {
            name: {seed: measures(run) for seed, run in by_seed.items()}
            for name, by_seed in runs.items()
        }
        made = {
            name: {key: estimate([each[key] for each in some.values()]) for key in MEASURES}
            for name, some in found.items()
        }
        rows = [
            (name, *(of[key].text(form, scale) for key, (_, form, scale) in MEASURES.items()))
            for name, of in made.items()
        ]
        each = [
            (name, seed, *of.values()) for name, some in found.items() for seed, of in some.items()
        ]
        header = ("rooms", *(title for title, *_ in MEASURES.values()))
        seeds = ", ".join(map(str, sorted({seed for some in found.values() for seed in some})))
        note = NOTE.format(held_out=HELD_OUT, seeds=seeds)
        return [
            *save_figure(_drawn(made), out, self.name, quick=quick),
            write_table(out / "building.md", header, rows, note, quick=quick),
            write_csv(out / "building_runs.csv", ("rooms", "seed", *MEASURES), each),
        ]


TARGET = Building()


def _cell(name: str, count: int, seeds: tuple[int, ...], *changes: str) -> Cell:
    """A building that is evaluated at its end alone, which costs less."""
    own = (f"rooms.count={count}", f"rooms.held_out={HELD_OUT}", "evaluation.every=1000000")
    return Cell(name, ("experiment=building", *own, *changes), seeds)


def _ticks(count: int) -> tuple[str, ...]:
    """A run of another length, with its schedules."""
    return (
        f"train.max_ticks={count}",
        f"agent.learning_rate_updates={count}",
        f"agent.epsilon.ticks={count // 3}",
    )


def measures(run: Run) -> dict[str, float]:
    """What a run came to, by ``MEASURES``.

    Raises:
        ConfigError: its weights are missing or damaged.
    """
    config, ticks = run.config, run.summary["rooms"]["ticks"]
    rooms = known_rooms(config, run.files)
    trained = [room for room in rooms if not room.held_out][:HELD_OUT]
    unseen = [_greedy(run, room, ADAPTED) for room in rooms if room.held_out]
    seen = [_greedy(run, room, 0) for room in trained]
    policies = [*zip(*unseen, strict=True), *zip(*seen, strict=True)]
    means = [mean([*scores]) for policy in policies for scores in zip(*policy, strict=True)]
    steps = config.train.worlds * sum(ticks)
    megabytes = _megabytes(config, trained[0], ticks)
    return dict(zip(MEASURES, [*means, steps, megabytes, run.summary["cpu_s"]], strict=True))


def _greedy(run: Run, room: Room, ticks: int) -> list[tuple[float, float]]:
    """Success, and EE as a share of the rule's, of each of a room's policies (``of_room``)."""
    config, policies = of_room(run.files.room(room.name), ticks)
    evaluator = Evaluator(config)
    rule = shortest_best_measures(evaluator).summary()["ee"]
    scores = []
    for model, ap in policies:
        (played,) = evaluator.play(model[None], ap, (0.0,))
        found = played.summary()
        scores.append((found["success"], found["ee"] / rule))
    return scores


def _megabytes(config: Config, room: Room, ticks: Sequence[int]) -> float:
    """Weights, online and target, that rooms take and hand on each time that they take part."""
    own = room.config(config)
    count = robot_network(own).parameters
    if config.rooms.access_points == "mean":
        count += ap_network(own).parameters
    rounds = sum(ticks) / (config.rooms.every * config.federation.every)
    return 2 * 2 * 4 * count * rounds / 1e6


def _drawn(made: Estimates) -> Figure:
    """Success and energy efficiency in held-out rooms against the number of rooms trained in."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    axes = figure.subplots(1, 2)
    counts = [count for count in COUNTS if ROOMS.format(count) in made]
    panels = (("success", "success"), ("share", "EE, % of the rule's"))
    for panel, (measure, label) in zip(axes, panels, strict=True):
        lines = (
            ("ee_share" if measure == "share" else measure, "held-out rooms, as it comes"),
            (f"adapted_{measure}", f"after {ADAPTED} ticks of its own"),
            (f"trained_{measure}", "rooms trained in"),
        )
        for (key, name), marker in zip(lines, "osd", strict=True):
            points = np.array([made[ROOMS.format(count)][key][:3] for count in counts])
            value, low, high = points.T * (100.0 if measure == "share" else 1.0)
            panel.errorbar(
                counts, value, (value - low, high - value), marker=marker, capsize=3, label=name
            )
        panel.set_xscale("log", base=2)
        panel.set_xticks(counts, [str(count) for count in counts])
        panel.set(xlabel="rooms trained in, R", ylabel=label)
        plain(panel)
    axes[0].legend(frameon=False)
    return figure
