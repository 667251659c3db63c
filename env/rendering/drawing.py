"""Pictures of the floor: the radio map, walls, AP, RIS, and where robots drove."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import numpy as np
from matplotlib import patheffects
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from env.arrays import Bools, Floats
from env.config import EnvConfig
from env.geometry.floor import Floor
from env.radio.radio_map import RadioMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

    from env.world import World

ROBOT_COLOURS = ("#e4572e", "#2e86de", "#f3b61f", "#8e44ad", "#16a085", "#d81b60", "#6d4c41")
"""Colours of the robots in turn; those of Fig. 5 come first."""

_OUTLINE = [patheffects.withStroke(linewidth=3.2, foreground="white")]


def best_gain_db(radio_map: RadioMap) -> Floats:
    """|h|^2 in dB at each cell under the phase setting that is best there, shape (cells,)."""
    cell = np.arange(len(radio_map.direct))
    amplitude = np.zeros(len(cell))
    for action in range(len(radio_map.settings)):
        amplitude = np.maximum(amplitude, np.abs(radio_map.channel(cell, np.array(action))))
    return np.asarray(20.0 * np.log10(amplitude))


def draw_floor(axes: Axes, config: EnvConfig, radio_map: RadioMap) -> AxesImage:
    """Draws the radio map with walls, AP and RIS; cells that solid walls cut off have no gain.

    Returns:
        The image of the map, for a colour bar.
    """
    floor = Floor.from_config(config)
    width, depth = floor.size_m
    gain = np.where(floor.drivable(), best_gain_db(radio_map), np.nan)
    low, high = np.nanpercentile(gain, (2, 98))
    gain = gain.reshape(floor.rows, floor.columns)
    image = axes.imshow(
        gain, origin="lower", extent=(0, width, 0, depth), cmap="Greys_r", vmin=low, vmax=high
    )
    ends = "projecting" if floor.solid else "butt"
    for colour, points in (("white", 6.5), ("black", 4.0)) if floor.solid else (("black", 4.0),):
        for x0, y0, x1, y1 in floor.walls:
            axes.plot([x0, x1], [y0, y1], color=colour, linewidth=points, solid_capstyle=ends)
    axes.set_facecolor("#c9b79c")
    ap, ris = config.ap.position_m, config.ris.position_m
    axes.plot(ap[0], ap[1], "^", color="#00b894", markersize=12, mec="black", clip_on=False)
    _label(axes, ap, "AP", _inwards(ap, floor))
    if config.ris.side:
        axes.plot(ris[0], ris[1], "s", color="#00cec9", markersize=10, mec="black", clip_on=False)
        _label(axes, ris, "RIS", _inwards(ris, floor))
    axes.set(xlim=(0, width), ylim=(0, depth), xlabel="x (m)", ylabel="y (m)", aspect="equal")
    return image


def _inwards(position: list[float], floor: Floor) -> tuple[int, int]:
    """Where a label goes, in points from its mark: away from the wall that is nearest."""
    (x, y), (width, depth) = position[:2], floor.size_m
    offsets = {(0, -16): depth - y, (-20, -4): width - x, (0, 16): y, (20, -4): x}
    return min(offsets, key=lambda offset: float(offsets[offset]))


def _label(axes: Axes, position: list[float], text: str, offset: tuple[int, int]) -> None:
    axes.annotate(
        text,
        (position[0], position[1]),
        xytext=offset,
        textcoords="offset points",
        ha="center",
        va="center",
        fontsize=9,
        weight="bold",
        path_effects=_OUTLINE,
    )


def draw_ways(axes: Axes, ways_m: Floats, destinations_m: Floats) -> None:
    """Draws where robots drove: a dot at the start, a star at the destination.

    Ways are positions in m, shape (slots + 1, K, 2), destinations (K, 2).
    """
    for robot, goal in enumerate(destinations_m):
        way = ways_m[:, robot]
        colour = ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]
        axes.plot(*way.T, color=colour, linewidth=1.8, path_effects=_OUTLINE, zorder=3)
        axes.plot(*way[0], "o", color=colour, markersize=8, mec="black", zorder=4)
        axes.plot(*goal, "*", color=colour, markersize=15, mec="black", zorder=4)


def draw_misses(axes: Axes, ends_m: Floats, destinations_m: Floats) -> None:
    """Draws a cross where a robot ended that did not arrive; both of shape (K, 2)."""
    for robot in np.flatnonzero(missed(ends_m, destinations_m)):
        colour = ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]
        axes.plot(*ends_m[robot], "X", color=colour, markersize=10, mec="black", zorder=5)


def missed(ends_m: Floats, destinations_m: Floats) -> Bools:
    """Which ends, shape (..., K, 2), are not at the destinations, shape (K, 2); shape (..., K)."""
    return np.asarray(~np.isclose(ends_m, destinations_m).all(axis=-1))


def trajectory_figure(
    config: EnvConfig,
    radio_map: RadioMap,
    ways_m: Floats,
    destinations_m: Floats,
    titles: list[str],
) -> Figure:
    """Episodes beside each other, each over the radio map and under its title.

    Ways are positions in m, shape (slots + 1, episodes, K, 2), destinations (K, 2).
    """
    count = len(titles)
    room = config.room
    height = 0.9 + 4.3 * min(room.depth_m / room.width_m, 2.0)
    figure = Figure(figsize=(4.6 * count + 0.9, height), layout="compressed")
    panels = figure.subplots(1, count, squeeze=False, sharey=True)[0]
    for index, axes in enumerate(panels):
        image = draw_floor(axes, config, radio_map)
        draw_ways(axes, ways_m[:, index], destinations_m)
        draw_misses(axes, ways_m[-1, index], destinations_m)
        axes.set_title(titles[index], fontsize=10, pad=9)
        if index:
            axes.set_ylabel("")
    figure.colorbar(image, ax=panels, label="channel gain, best phase (dB)", pad=0.01)
    marks = [("o", "start"), ("*", "destination"), ("^", "AP"), ("s", "RIS")]
    if missed(ways_m[-1], destinations_m).any():
        marks.insert(2, ("X", "did not arrive"))
    handles = [_handle(marker, label) for marker, label in marks]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(marks), frameon=False)
    return figure


def _handle(marker: str, label: str) -> Line2D:
    colour = {"^": "#00b894", "s": "#00cec9"}.get(marker, "#bbbbbb")
    return Line2D([], [], marker=marker, color=colour, mec="black", linestyle="", label=label)


class Picture:
    """The floor, drawn once; each frame adds the ways to a copy of its pixels.

    Args:
        world: whose floor it is.
    """

    def __init__(self, world: World) -> None:
        figure = Figure(figsize=(4.8, 4.8), dpi=100, layout="constrained")
        self._canvas = cast(Any, FigureCanvasAgg(figure))
        self._axes = figure.subplots()
        draw_floor(self._axes, world.config, world.radio_map)
        self._axes.set_title(" ", fontsize=10)
        self._canvas.draw()
        self._floor = self._canvas.copy_from_bbox(figure.bbox)

    def frame(self, ways_m: Floats, goals_m: Floats, title: str) -> NDArray[np.uint8]:
        """The pixels with the ways so far, shape (480, 480, 3)."""
        axes, still = self._axes, len(self._axes.lines)
        self._canvas.restore_region(self._floor)
        draw_ways(axes, ways_m, goals_m)
        for robot, place in enumerate(ways_m[-1]):
            colour = ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]
            axes.plot(*place, "o", color=colour, mec="black", markersize=10, zorder=5)
        axes.title.set_text(title)
        axes.draw_artist(axes.title)
        for line in sorted(axes.lines[still:], key=lambda line: line.get_zorder()):
            axes.draw_artist(line)
            line.remove()
        return np.array(self._canvas.buffer_rgba())[..., :3].copy()
