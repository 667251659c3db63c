"""Drawing Fig. 5: a panel for each M_R, QoS in colours and QoE in black, as in the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from env.rendering.drawing import ROBOT_COLOURS, best_gain_db, draw_floor, missed
from experiments.analysis.played import PlayedEpisodes
from experiments.reproduce.results.output import plain
from training.recording.figures import running_mean

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GREYS = LinearSegmentedColormap.from_list("pale", ["#8d99ae", "#ffffff"])
"""Pale enough for black marks to stand out where the gain is low."""

SMOOTHING = 10
"""Slots over which lines along the way are averaged; fig5.csv has each slot."""


class Shown(NamedTuple):
    """An episode that can be drawn.

    Attributes:
        side: M_R.
        metric: what rewards or plans count, qos or qoe.
        policy: learned or planned.
        seed: of the policy; None of a plan.
        drive: the episode.
    """

    side: int
    metric: str
    policy: str
    seed: int | None
    drive: PlayedEpisodes


def draw_ways(shown: Sequence[Shown], note: str) -> Figure:
    """Where the robots drive, over the gain of the best phase in each cell, on one scale."""
    sides = sorted({each.side for each in shown})
    rows = ceil(len(sides) / 2)
    figure = Figure(figsize=(9.2, 1.4 + 4.1 * rows), layout="compressed")
    panels = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False).ravel()
    drives = [each.drive for each in shown]
    maps = [best_gain_db(drive.world.radio_map) for drive in drives]
    low, high = np.percentile(np.concatenate(maps), (2, 98))
    for index, (side, axes) in enumerate(zip(sides, panels, strict=False)):
        of = {each.metric: each.drive for each in shown if each.side == side}
        world = of["qos"].world
        image = draw_floor(axes, world.config, world.radio_map)
        image.set(cmap=GREYS, clim=(low, high))
        _ways(axes, of)
        title = f"({'abcdefgh'[index]}) $M_R$ = {side}" + ("" if side else " (no RIS)")
        axes.set_title(title, fontsize=10, pad=10)
        axes.label_outer()
    figure.colorbar(image, ax=list(panels), label="channel gain, best phase (dB)", pad=0.01)
    crosses = any(_misses(drive).any() for drive in drives)
    handles = _handles(shown[0].drive, crosses)
    figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False)
    figure.supxlabel(f"{note}\n", fontsize=7.5, x=0.01, ha="left")
    return figure


def _ways(axes: Axes, of: Mapping[str, PlayedEpisodes]) -> None:
    """Draws the ways of both metrics, QoE's black crosses on top of QoS's coloured dots."""
    for robot, goal_m in enumerate(of["qos"].destinations_m):
        colour = ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]
        way = of["qos"].ways_m[:, 0, robot]
        axes.plot(*way.T, "o", color=colour, ms=4.2, mec="none", zorder=3)
        axes.plot(*of["qoe"].ways_m[:, 0, robot].T, "x", color="black", ms=2.8, mew=0.8, zorder=4)
        axes.plot(*way[0], "o", color=colour, ms=9, mec="black", zorder=5)
        axes.plot(*goal_m, "*", color=colour, ms=15, mec="black", zorder=5)
    for metric, drive in of.items():
        for robot in np.flatnonzero(_misses(drive)).tolist():
            face = ROBOT_COLOURS[robot % len(ROBOT_COLOURS)] if metric == "qos" else "black"
            axes.plot(*drive.ways_m[-1, 0, robot], "X", color=face, ms=10, mec="white", zorder=6)


def _misses(drive: PlayedEpisodes) -> NDArray[np.bool_]:
    """Which robots do not arrive, shape (K,)."""
    return missed(drive.ways_m[-1, 0], drive.destinations_m)


def _handles(drive: PlayedEpisodes, crosses: bool) -> list[Line2D]:
    found = [
        _handle(f"robot {robot}, QoS", linestyle="", marker="o", color=colour)
        for robot, colour in enumerate(ROBOT_COLOURS[: len(drive.destinations_m)])
    ]
    marks = [("x", "black", "QoE"), ("o", "#bbbbbb", "start"), ("*", "#bbbbbb", "destination")]
    if crosses:
        marks.append(("X", "#777777", "did not arrive"))
    for marker, colour, label in marks:
        edge = "black" if colour == "#bbbbbb" else colour
        found.append(_handle(label, linestyle="", marker=marker, color=colour, mec=edge))
    return found


def _handle(label: str, **style: Any) -> Line2D:
    return Line2D([], [], label=label, **style)


def draw_along(shown: Sequence[Shown], note: str) -> Figure:
    """Gain and rate of each robot, the mean of the last slots: a row for each M_R.

    Under NOMA the strongest robot of a slot has most of the rate, and who that is changes from one
    slot to the next.
    """
    sides = sorted({each.side for each in shown})
    figure = Figure(figsize=(9.2, 1.0 + 2.2 * len(sides)), layout="constrained")
    panels = figure.subplots(len(sides), 2, sharex=True, sharey="col", squeeze=False)
    for row, side in zip(panels, sides, strict=True):
        for each in (each for each in shown if each.side == side):
            _lines(row[0], each.drive.along.gain_db[:, 0], each.metric)
            _lines(row[1], each.drive.along.rate[:, 0], each.metric)
        row[0].set_ylabel(f"$M_R$ = {side}\ngain (dB)")
        row[1].set_ylabel("rate (bit/s/Hz)")
        for axes in row:
            plain(axes)
    for axes in panels[-1]:
        axes.set_xlabel("slot")
    for axes, what in zip(panels[0], (r"$|h_k|^2$ under the phase set", "$R_k$"), strict=True):
        axes.set_title(f"{what}, mean of {SMOOTHING} slots", fontsize=10)
    robots = len(shown[0].drive.destinations_m)
    handles = [
        _handle(f"robot {robot}, {name}", color=ROBOT_COLOURS[robot], linestyle=style)
        for robot in range(robots)
        for name, style in (("QoS", "-"), ("QoE", ":"))
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=robots, frameon=False)
    figure.supxlabel(f"{note}\n", fontsize=7.5, x=0.01, ha="left")
    return figure


def _lines(axes: Axes, values: NDArray[np.float64], metric: str) -> None:
    """Draws a line for each robot as long as it drives, values of shape (T, K), QoE's dotted."""
    for robot, line in enumerate(values.T):
        smooth = running_mean(line[np.isfinite(line)], SMOOTHING)
        colour = ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]
        axes.plot(smooth, ":" if metric == "qoe" else "-", color=colour, lw=1.3)
