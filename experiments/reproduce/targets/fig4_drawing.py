"""Drawing Fig. 4: a row of panels for each K, a column for each M_R, all on one scale."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.reproduce.results.output import plain
from experiments.reproduce.targets.fig4_points import BEST, LEARNED, PLANNED, PLANNED_AGAIN, Point

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ARRIVE = 0.9
"""Success below which a point is hollow: EE then speaks of robots that do not arrive."""

LETTERS_PER_INCH = 18
"""Of the note below the figure."""


class Style(NamedTuple):
    """How a curve is drawn; planned ones have no marker."""

    label: str
    colour: str
    line: Literal["-", "-.", "--", ":"]
    marker: str = ""


STYLES = {
    ("noma", LEARNED): Style("NOMA, learned", "#2e86de", "-", "o"),
    ("oma", LEARNED): Style("OMA, learned", "#e4572e", "-", "s"),
    ("noma", BEST): Style("NOMA, learned, best", "#0b4f8a", "-.", "^"),
    ("oma", BEST): Style("OMA, learned, best", "#8a2a12", "-.", "v"),
    ("noma", PLANNED): Style("NOMA, planned", "#2e86de", "--"),
    ("oma", PLANNED): Style("OMA, planned", "#e4572e", "--"),
    ("oma", PLANNED_AGAIN): Style("OMA, reallocated, planned", "#e4572e", ":"),
}
"""By access and curve."""


def draw(drawn: Sequence[Point], note: str) -> Figure:
    """The figure with its points, and what it says below itself."""
    rows = sorted({point.robots for point in drawn})
    columns = sorted({point.side for point in drawn})
    size = (1.0 + 3.4 * len(columns), 1.5 + 2.9 * len(rows))
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(rows), len(columns), sharex=True, sharey=True, squeeze=False)
    for row, robots in enumerate(rows):
        for column, side in enumerate(columns):
            axes = panels[row, column]
            here = [point for point in drawn if (point.robots, point.side) == (robots, side)]
            _panel(axes, here)
            surface = f"$M_R$ = {side}" if side else "no RIS"
            axes.set_title(f"K = {robots}, {surface}", fontsize=10)
            if row == len(rows) - 1:
                axes.set_xlabel(r"$P_{\max}$ (dBm)")
            if not column:
                axes.set_ylabel("EE (bit/s/Hz/J)")
    panels[0, 0].set_ylim(bottom=0.0)
    figure.legend(handles=_handles(drawn), loc="outside upper center", ncols=3, frameon=False)
    lines = [fill(line, int(LETTERS_PER_INCH * size[0])) for line in note.splitlines()]
    figure.supxlabel("\n".join([*lines, ""]), fontsize=7.5, x=0.01, ha="left")
    return figure


def _panel(axes: Axes, here: Sequence[Point]) -> None:
    """Draws the curves; marks are hollow where fewer than ``ARRIVE`` of the robots arrive."""
    for of, style in STYLES.items():
        line = sorted(
            (point for point in here if (point.access, point.curve) == of),
            key=lambda point: point.max_dbm,
        )
        if not line:
            continue
        power_dbm, colour = [point.max_dbm for point in line], style.colour
        axes.plot(power_dbm, [point.ee for point in line], style.line, color=colour, lw=1.4)
        if style.marker:
            low, high = [point.low for point in line], [point.high for point in line]
            axes.fill_between(power_dbm, low, high, color=colour, alpha=0.18, linewidth=0)
            for point in line:
                face = colour if point.success >= ARRIVE else "white"
                marks: dict[str, Any] = {"color": colour, "mfc": face, "ms": 5.5, "zorder": 3}
                axes.plot(point.max_dbm, point.ee, style.marker, **marks)
    plain(axes)
    axes.set_xticks(sorted({point.max_dbm for point in here}))


def _handles(drawn: Sequence[Point]) -> list[Line2D]:
    there = {(point.access, point.curve) for point in drawn}
    found = [
        Line2D([], [], label=each.label, color=each.colour, linestyle=each.line, marker=each.marker)
        for of, each in STYLES.items()
        if of in there
    ]
    if any(point.success < ARRIVE for point in drawn):
        hollow: dict[str, Any] = {"color": "#777777", "marker": "o", "mfc": "white"}
        found.append(Line2D([], [], label="fewer than 90 % arrive", linestyle="", **hollow))
    return found
