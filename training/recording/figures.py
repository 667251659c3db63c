"""Figures of a single run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from conf import Config
from env.rendering.drawing import trajectory_figure
from training.evaluation import Evaluator
from training.recording.history import History
from training.trace import Trace

SMOOTHING = 10
DRAWN_EPISODES = 3
DPI = 130


def save_figures(
    folder: Path,
    config: Config,
    evaluator: Evaluator,
    robots: NDArray[np.float32],
    ap: NDArray[np.float32],
    history: History,
) -> None:
    """Draws how a run learned, and the ways that its final policy drives.

    ``robots`` and ``ap`` as in ``Evaluator.play``; the folder is made if it is missing.
    """
    folder.mkdir(exist_ok=True)
    learning_curve(
        [row["reward"] for row in history.episodes],
        [row["success"] for row in history.episodes],
        [int(row["episode"]) for row in history.evaluations],
        [row["success"] for row in history.evaluations],
        config.evaluation.epsilon,
    ).savefig(folder / "learning_curve.png", dpi=DPI)
    world, trace = evaluator.world, Trace(slice(DRAWN_EPISODES))
    evaluator.play(robots, ap, (0.0,), trace.see)
    trace.finish(world)
    ways = trace.ways_m(world)
    trajectory_figure(
        config.env,
        world.radio_map,
        ways,
        world.floor.centres()[world.destinations],
        [f"held-out start {index + 1}, greedy" for index in range(ways.shape[1])],
    ).savefig(folder / "trajectories.png", dpi=DPI)


def running_mean(values: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Mean over the last ``width`` values, over fewer at the beginning; same shape (n,)."""
    total = np.cumsum(np.concatenate([[0.0], values]))
    end = np.arange(1, len(values) + 1)
    start = np.maximum(end - width, 0)
    return np.asarray((total[end] - total[start]) / (end - start))


def learning_curve(
    reward: Sequence[float],
    success: Sequence[float],
    evaluated_at: Sequence[int],
    evaluated: Sequence[float],
    epsilon: float,
) -> Figure:
    """Total reward of the training episodes, and success in training and when frozen.

    Args:
        reward: total reward of each training episode.
        success: share of the robots that arrived in each.
        evaluated_at: training episodes after which frozen weights were evaluated.
        evaluated: their success.
        epsilon: exploration of those evaluations.
    """
    figure, top, bottom = _panels()
    episode = np.arange(1, len(reward) + 1)
    top.plot(episode, reward, color="#2e86de", alpha=0.3, linewidth=0.8)
    if reward:
        top.plot(episode, running_mean(np.asarray(reward), SMOOTHING), color="#2e86de")
    top.set(ylabel="total reward of an episode", title="Training")
    if success:
        smooth = running_mean(np.asarray(success), SMOOTHING)
        bottom.plot(episode, smooth, color="#999999", label=f"training, mean of {SMOOTHING}")
    bottom.plot(
        evaluated_at,
        evaluated,
        "o-",
        color="#e4572e",
        markersize=4,
        label=f"frozen, held-out starts, eps = {epsilon:g}",
    )
    bottom.set(xlabel="training episode", ylabel="robots that arrive", ylim=(-0.02, 1.05))
    bottom.legend(
        loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, ncols=2, frameon=False
    )
    return figure


def _panels() -> tuple[Figure, Axes, Axes]:
    """A figure of two panels, one above the other."""
    figure = Figure(figsize=(7, 5.6), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    for axes in (top, bottom):
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    return figure, top, bottom


def save_rooms_figure(path: Path, rows: Sequence[Mapping[str, float]]) -> None:
    """Draws how many robots arrive in each room over training, and their energy efficiency.

    Args:
        path: of the picture.
        rows: of ``rooms.csv``: two for each room and evaluation; the greedy ones are drawn.
    """
    figure, *panels = _panels()
    kinds = ((0, "#2e86de", "trained in"), (1, "#e4572e", "held out"))
    for axes, measure in zip(panels, ("success", "ee"), strict=True):
        for held_out, colour, label in kinds:
            own = [row for row in rows if row["held_out"] == held_out and row["epsilon"] == 0]
            by_room: dict[float, dict[float, float]] = {}
            by_tick: dict[float, list[float]] = {}
            for row in own:
                by_room.setdefault(row["room"], {})[row["tick"]] = row[measure]
                by_tick.setdefault(row["tick"], []).append(row[measure])
            for each in by_room.values():
                axes.plot(list(each), list(each.values()), color=colour, alpha=0.2, linewidth=0.8)
            means = [float(np.mean(values)) for values in by_tick.values()]
            if means:
                axes.plot(list(by_tick), means, "o-", color=colour, markersize=4, label=label)
    top, bottom = panels
    top.set(ylabel="robots that arrive", ylim=(-0.02, 1.05), title="Rooms, greedy: means and each")
    bottom.set(xlabel="ticks of a room", ylabel="EE (bit/s/Hz/J)")
    if top.get_legend_handles_labels()[0]:
        top.legend(loc="lower right", frameon=False)
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, dpi=DPI)
