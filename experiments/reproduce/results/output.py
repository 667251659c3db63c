"""How a target writes figures, data and tables."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from storage.atomic import write_atomically

DPI = 150
QUICK = "quick: few seeds and short runs, not for comparison"
STAMP_INCHES = 0.25

Row = Sequence[object]


def save_figure(figure: Figure, out: Path, name: str, *, quick: bool) -> list[Path]:
    """Writes ``name``.png and .svg, the same bytes each time; a quick figure says that it is."""
    if quick:
        strip = STAMP_INCHES / figure.get_figheight()
        engine = figure.get_layout_engine()
        if isinstance(engine, ConstrainedLayoutEngine):
            engine.set(rect=(0.0, strip, 1.0, 1.0 - strip))
        figure.text(0.995, 0.005, QUICK, ha="right", va="bottom", fontsize=8, color="#c0392b")
    png, svg = out / f"{name}.png", out / f"{name}.svg"
    with mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(png, dpi=DPI)
        figure.savefig(svg, metadata={"Date": None})
    return [png, svg]


def plain(axes: Axes) -> None:
    """A light grid and no frame."""
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def write_csv(path: Path, header: Sequence[str], rows: Sequence[Row]) -> Path:
    """Writes a CSV file; numbers have six digits, None is empty."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(header)
    writer.writerows([_short(value) for value in row] for row in rows)
    write_atomically(path, text.getvalue())
    return path


def _short(value: object) -> object:
    return format(value, ".6g") if isinstance(value, float) else value


def write_table(
    path: Path, header: Sequence[str], rows: Sequence[Row], note: str, *, quick: bool = False
) -> Path:
    """Writes a Markdown table with a note below it, which says if the table is a quick one."""
    lines = [header, ["---"] * len(header), *rows]
    text = "".join("| " + " | ".join(map(str, line)) + " |\n" for line in lines)
    write_atomically(path, f"{text}\n{note}{f' {QUICK.capitalize()}.' if quick else ''}\n")
    return path
