"""Drawing Fig. 4: a row of panels for each K, a column for each M_R, all on one scale."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.reproduce.results.output import plain
from experiments.reproduce.results.points import BEST, LEARNED, PLANNED, PLANNED_AGAIN, Point

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ARRIVE = 0.9
"""Success below which a point is hollow: EE then speaks of robots that do not arrive."""

LETTERS_PER_INCH = 18
"""Of the note below the figure."""

COLOURS = {"noma": "#2e86de", "oma": "#e4572e"}
DARKER = {"noma": "#0b4f8a", "oma": "#8a2a12"}
"""Of ``experiment=best``, whose marks have other forms as well."""

MARKERS = {
    ("noma", LEARNED): "o",
    ("oma", LEARNED): "s",
    ("noma", BEST): "^",
    ("oma", BEST): "v",
}
LABELS = {
    ("noma", LEARNED): "NOMA, learned",
    ("oma", LEARNED): "OMA, learned",
    ("noma", BEST): "NOMA, learned, best",
    ("oma", BEST): "OMA, learned, best",
    ("noma", PLANNED): "NOMA, planned",
    ("oma", PLANNED): "OMA, planned",
    ("oma", PLANNED_AGAIN): "OMA, reallocated, planned",
}
STYLES = {LEARNED: "-", BEST: "-.", PLANNED: "--", PLANNED_AGAIN: ":"}


def draw(drawn: Sequence[Point], note: str) -> Figure:
    """The figure.

    Args:
        drawn: its points.
        note: what it says below itself.
    """
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
    for access, curve in LABELS:
        line = sorted(
            (point for point in here if (point.access, point.curve) == (access, curve)),
            key=lambda point: point.max_dbm,
        )
        if not line:
            continue
        power_dbm = [point.max_dbm for point in line]
        colour = _colour(access, curve)
        axes.plot(power_dbm, [point.ee for point in line], STYLES[curve], color=colour, lw=1.4)
        if (access, curve) in MARKERS:
            low, high = [point.low for point in line], [point.high for point in line]
            axes.fill_between(power_dbm, low, high, color=colour, alpha=0.18, linewidth=0)
            _marks(axes, line)
    plain(axes)
    axes.set_xticks(sorted({point.max_dbm for point in here}))


def _marks(axes: Axes, line: Sequence[Point]) -> None:
    """Marks learned points, hollow where fewer than ``ARRIVE`` of the robots arrive."""
    for point in line:
        colour = _colour(point.access, point.curve)
        face = colour if point.success >= ARRIVE else "white"
        marker = MARKERS[point.access, point.curve]
        axes.plot(point.max_dbm, point.ee, marker, color=colour, mfc=face, ms=5.5, zorder=3)


def _colour(access: str, curve: str) -> str:
    return (DARKER if curve == BEST else COLOURS)[access]


def _handles(drawn: Sequence[Point]) -> list[Line2D]:
    there = {(point.access, point.curve) for point in drawn}
    found = []
    for (access, curve), label in LABELS.items():
        if (access, curve) in there:
            style: dict[str, Any] = {
                "color": _colour(access, curve),
                "linestyle": STYLES[curve],
                "marker": MARKERS.get((access, curve), ""),
            }
            found.append(Line2D([], [], label=label, **style))
    if any(point.success < ARRIVE for point in drawn):
        hollow: dict[str, Any] = {
            "color": "#777777",
            "linestyle": "",
            "marker": "o",
            "mfc": "white",
        }
        found.append(Line2D([], [], label="fewer than 90 % arrive", **hollow))
    return found
