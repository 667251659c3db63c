"""Episodes as films: the floor, robots on their ways, and what each of them is served."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from PIL import Image

from conf import ConfigError
from experiments.viewer.replays import Panel
from experiments.viewer.scene import COLOURS, NO_WAY

SLOTS_PER_S = 8
REST_S = 1.5
"""How long the last picture stays."""

DPI = 100
Pixels = NDArray[np.uint8]


def save_film(panels: Sequence[Panel], out: Path, frames_per_slot: int) -> None:
    """Writes a film of episodes side by side.

    Args:
        panels: the episodes.
        out: where to; ``.gif``, or ``.mp4`` with the package imageio-ffmpeg.
        frames_per_slot: pictures for each slot.

    Raises:
        ConfigError: that package is missing.
    """
    part = out.with_name(f".{out.name}.part{out.suffix}")
    try:
        write = _save_mp4 if out.suffix == ".mp4" else _save_gif
        write(frames(panels, frames_per_slot), part, SLOTS_PER_S * frames_per_slot)
        part.replace(out)
    finally:
        part.unlink(missing_ok=True)


def frames(panels: Sequence[Panel], frames_per_slot: int) -> Iterator[Pixels]:
    """The pictures of a film, each of shape (height, width, 3), both sides even."""
    figure = Figure(figsize=(4.4 * len(panels), 5.6), dpi=DPI, layout="constrained")
    canvas = cast(Any, FigureCanvasAgg(figure))
    columns = figure.subplots(2, len(panels), squeeze=False, height_ratios=(4.4, 1.0)).T
    shows = [_Show(panel, *axes) for panel, axes in zip(panels, columns, strict=True)]
    end = max(show.slots for show in shows)
    canvas.draw()
    figure.set_layout_engine("none")  # nothing moves but the robots
    for frame in range(end * frames_per_slot + 1):
        for show in shows:
            show.at(frame / frames_per_slot)
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())[..., :3]
        yield pixels[: pixels.shape[0] // 2 * 2, : pixels.shape[1] // 2 * 2].copy()


class _Show:
    """An episode in two axes: the floor, and rates as bars below it."""

    def __init__(self, panel: Panel, floor: Axes, bars: Axes) -> None:
        self._scene, self._episode = panel["scene"], panel["episode"]
        self.slots = len(self._episode["cells"]) - 1
        colours = self._scene["colours"]
        self._colours = [colours[k % len(colours)] for k in range(len(self._scene["destinations"]))]
        self._ways = self._centres(self._episode["cells"])
        _draw_scene(floor, self._scene)
        floor.set_title(panel["title"], fontsize=9)
        goals = self._centres([self._scene["destinations"]])[0]
        self._trails, self._robots = [], []
        for robot, (goal, colour) in enumerate(zip(goals, self._colours, strict=True)):
            floor.plot(*goal, "*", color=colour, mec="black", ms=13, clip_on=False)
            self._trails.append(floor.plot([], [], color=colour, lw=2)[0])
            (mark,) = floor.plot([], [], "o", color=colour, mec="black", ms=11, zorder=5)
            number = floor.text(0, 0, str(robot), ha="center", va="center", color="white",
                                fontsize=7, weight="bold", zorder=6)  # fmt: skip
            number.set_path_effects([withStroke(linewidth=1.5, foreground="black")])
            self._robots.append((mark, number))
        self._rates = np.array(self._episode["rates"])
        self._driving = np.array(self._episode["driving"], dtype=bool)
        robots = np.arange(len(goals))
        self._bars = bars.barh(robots, np.zeros(len(goals)), color=self._colours, edgecolor="black")
        bars.set(xlim=(0, max(self._rates.max(), 1e-9)), ylim=(len(goals) - 0.5, -0.5))
        bars.set_yticks(robots, [f"robot {k}" for k in robots], fontsize=8)
        bars.tick_params(axis="x", labelsize=7)
        self._said = bars.set_xlabel("rate", fontsize=8)  # its height is laid out for
        bars.spines[["top", "right"]].set_visible(False)

    def at(self, time: float) -> None:
        """Shows a time in slots."""
        slot = min(int(time), self.slots)
        then = min(slot + 1, self.slots)
        place = self._ways[slot] + (self._ways[then] - self._ways[slot]) * (time - slot)
        for robot, (mark, number) in enumerate(self._robots):
            x, y = place[robot]
            mark.set_data([x], [y])
            number.set_position((x, y))
            way = np.vstack([self._ways[: slot + 1, robot], place[robot]])
            self._trails[robot].set_data(*way.T)
        drives = self._driving[slot] if slot < self.slots else np.zeros(len(place), dtype=bool)
        rates = np.where(drives, self._rates[min(slot, self.slots - 1)], 0.0)
        for bar, rate in zip(self._bars, rates, strict=True):
            bar.set_width(rate)
        self._said.set_text(f"rate in bit/s/Hz, slot {min(slot + 1, self.slots)} of {self.slots}")

    def _centres(self, cells: Sequence[Sequence[int]]) -> NDArray[np.float64]:
        """Positions in m, shape (..., K, 2)."""
        row, column = np.divmod(np.array(cells), self._scene["columns"])
        return np.asarray((np.stack([column, row], axis=-1) + 0.5) * self._scene["cell_m"])


def _draw_scene(axes: Axes, scene: dict[str, Any]) -> None:
    width, depth = scene["size_m"]
    shades = np.frombuffer(base64.b64decode(scene["map"]), np.uint8)
    shades = np.where(shades == NO_WAY, np.nan, shades.astype(float))
    axes.imshow(
        shades.reshape(scene["rows"], scene["columns"]),
        origin="lower", extent=(0, width, 0, depth), cmap="gray", vmin=-40, vmax=255,
    )  # fmt: skip
    axes.set_facecolor("#c9b79c")
    for x0, y0, x1, y1 in scene["walls"]:
        axes.plot([x0, x1], [y0, y1], color="black", lw=3)
    axes.plot(*scene["ap"], "^", color="#00b894", mec="black", ms=10, clip_on=False)
    if scene["ris"]:
        axes.plot(*scene["ris"], "s", color="#00cec9", mec="black", ms=9, clip_on=False)
    axes.set(xlim=(0, width), ylim=(0, depth), aspect="equal")
    axes.set_xticks([])
    axes.set_yticks([])


def _save_gif(pictures: Iterator[Pixels], out: Path, rate: int) -> None:
    """Writes a GIF that plays for ever, all pictures with one palette."""
    first = next(pictures)
    palette = Image.fromarray(np.concatenate([first, _swatches(first.shape[1])])).quantize(128)

    def with_palette(pixels: Pixels) -> Image.Image:
        return Image.fromarray(pixels).quantize(palette=palette, dither=Image.Dither.NONE)

    others = [with_palette(each) for each in pictures]
    ends = np.round(100 * np.arange(len(others) + 1) / rate).astype(int)  # GIF counts in 10 ms
    pause = [*(10 * np.diff(ends)).tolist(), int(1000 * REST_S)]
    with_palette(first).save(
        out, save_all=True, append_images=others, duration=pause, loop=0, disposal=1
    )


def _swatches(width: int) -> Pixels:
    """The robots' colours in blocks, so that a palette has them however small robots are."""
    colours = (255 * np.array([to_rgb(colour) for colour in COLOURS])).astype(np.uint8)
    block = -(-width // len(colours))
    return np.tile(np.repeat(colours, block, axis=0)[:width], (60, 1, 1))


def _save_mp4(pictures: Iterator[Pixels], out: Path, rate: int) -> None:
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise ConfigError(
            f"--out {out.suffix}: allowed is .gif, or .mp4 with the package imageio-ffmpeg"
            " (pip install 'risfleet[film]')."
        ) from error
    first = next(pictures)
    height, width, _ = first.shape
    writer = imageio_ffmpeg.write_frames(str(out), (width, height), fps=rate, macro_block_size=2)
    writer.send(None)
    last = first
    try:
        writer.send(first)
        for last in pictures:
            writer.send(last)
        for _ in range(int(REST_S * rate)):
            writer.send(last)
    finally:
        writer.close()
