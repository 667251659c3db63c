"""Frames of an episode as pixels, for rendering."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from env.arrays import Floats
from env.rendering.drawing import ROBOT_COLOURS, draw_floor, draw_ways
from env.world import World


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
