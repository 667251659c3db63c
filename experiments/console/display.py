"""What the user sees of a run: live progress, and the table at its end."""

from __future__ import annotations

import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Self

from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from experiments.console import PLAIN
from experiments.console.mishaps import in_words
from training.recording.history import MEASURES
from training.run_folder import RunFolder

POLL_S = 0.5
LINE_PERIOD_S = 10.0
SILENT_S = 10.0
"""A run that writes nothing for longer may have died."""

RUNNING = ("starting", "training", "waiting", "finishing")
LABELS = {
    "success": "success",
    "path_ratio": "path ratio",
    "ee": "EE (bit/s/Hz/J)",
    "ee_bits_per_joule": "EE (bit/J)",
    "sum_rate": "sum rate (bit/s/Hz)",
    "min_rate": "min rate (bit/s/Hz)",
    "sic_violations": "SIC violations",
    "projections": "projections",
}
assert set(LABELS) == set(MEASURES)


def silent_s(status: dict[str, Any]) -> float | None:
    """Seconds since a run last wrote; None if it has ended, or wrote no time."""
    if status["state"] not in RUNNING or not isinstance(status["written_at"], int | float):
        return None
    return max(time.time() - status["written_at"], 0.0)


def share_done(status: dict[str, Any]) -> float:
    """How much of a run is done, 0 to 1, by episodes or ticks, whichever ends it first."""
    done = float(status["episode"] / status["episodes"])
    if status["max_ticks"]:
        done = max(done, status["tick"] / status["max_ticks"])
    return min(done, 1.0)


def seconds_left(status: dict[str, Any]) -> float | None:
    """An estimate of the time left: the ticks to come at the rate so far."""
    rate, slots = status["steps_per_s"], status["slots"]
    if not rate or not slots or status["state"] != "training":
        return None
    ticks = (status["episodes"] - status["episode"]) * slots
    if status["max_ticks"]:
        ticks = min(ticks, status["max_ticks"] - status["tick"])
    return float(max(ticks, 0) / rate)


def describe(status: dict[str, Any]) -> list[tuple[str, str]]:
    """The labelled figures of a run's progress."""
    left = seconds_left(status)
    minutes, seconds = divmod(round(left or 0), 60)
    return [
        ("", str(status["state"])),
        ("episode", f"{status['episode']}/{status['episodes']}"),
        ("tick", str(status["tick"])),
        ("success", _number(status["success"], ".2f")),
        ("frozen", _number(status["evaluated"], ".2f")),
        ("reward", _number(status["reward"], ".0f")),
        ("EE", _number(status["ee"], ".4f")),
        ("steps/s", _number(status["steps_per_s"] or None, ".0f")),
        ("left", "-" if left is None else f"{minutes}:{seconds:02d}"),
    ]


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


class Showing(ABC):
    """Shows something from a thread of its own, until the block that it is entered for ends.

    What goes wrong with it is said in a line, and the block goes on without.
    """

    def __init__(self, name: str) -> None:
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._show, name=name, daemon=True)

    def __enter__(self) -> Self:
        """Begins to show."""
        try:
            self._thread.start()
        except RuntimeError as error:  # this machine has no thread left
            self._give_up(error)
        return self

    def __exit__(self, *error: object) -> None:
        """Shows the last state and ends."""
        self._ended.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _show(self) -> None:
        try:
            self._run()
        except Exception as error:
            self._give_up(error)

    def _give_up(self, error: Exception) -> None:
        why = f"{type(error).__name__}: {in_words(error)}"
        print(f"risfleet: no progress is shown from here on ({why})", file=sys.stderr)

    @abstractmethod
    def _run(self) -> None:
        """Shows, until ``_ended`` is set."""

    def _statuses(self, folder: RunFolder) -> Iterator[tuple[dict[str, Any], bool]]:
        """What a run says of itself, again and again, and whether it is for the last time."""
        ended = False
        while not ended:
            ended = self._ended.wait(POLL_S)
            if (status := folder.read_progress()) is not None:
                yield status, ended


class Display(Showing):
    """Shows the progress of a run of any runtime, from what it writes to its folder.

    Live on a terminal; elsewhere a plain line every ten seconds.
    """

    def __init__(self, folder: RunFolder, console: Console) -> None:
        super().__init__("display")
        self._folder, self._console = folder, console

    def _run(self) -> None:
        if not self._console.is_terminal:
            self._print_lines()
            return
        with Live(console=self._console, refresh_per_second=4, transient=True) as live:
            for status, _ in self._statuses(self._folder):
                live.update(panel(status))

    def _print_lines(self) -> None:
        shown, printed = "", 0.0
        for status, ended in self._statuses(self._folder):
            due = not ended and time.monotonic() - printed >= LINE_PERIOD_S
            if due or status["state"] != shown:
                shown, printed = status["state"], time.monotonic()
                line = "  ".join(f"{name} {text}".strip() for name, text in describe(status))
                waiting = f"waiting: {status['message']}"
                self._console.print(waiting if shown == "waiting" else line, **PLAIN)


def panel(status: dict[str, Any]) -> Table:
    """A run's progress: a bar, and its figures below."""
    outer = Table.grid(padding=(0, 0))
    outer.add_row(ProgressBar(total=1.0, completed=share_done(status), width=60))
    figures = Table.grid(padding=(0, 2))
    columns = describe(status)
    figures.add_row(*(f"[dim]{label or 'state'}[/dim]" for label, _ in columns))
    figures.add_row(*(text for _, text in columns))
    outer.add_row(figures)
    if status["state"] == "waiting":
        outer.add_row(Text(str(status["message"])))
    return outer


def evaluation_table(title: str, columns: dict[str, dict[str, float]]) -> Table:
    """A table of evaluations, a column with its measures each."""
    rows = (
        (label, *(measure(key, values.get(key)) for values in columns.values()))
        for key, label in LABELS.items()
    )
    return table(title, ("", *columns), rows)


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> Table:
    """A table whose first column holds names, and all others numbers."""
    made = Table(title=Text(title), title_justify="left")
    for place, name in enumerate(columns):
        made.add_column(name, justify="right" if place else "left")
    for row in rows:
        made.add_row(*row)
    return made


def measure(key: str, value: float | None) -> str:
    """A measure of an evaluation as it is shown, by its name in ``MEASURES``."""
    if value is None or value != value:
        return "-"
    return format(value, ".4f" if key == "ee" else ".3f")


def summary_table(summary: Mapping[str, Any]) -> Table:
    """What the policy of a run is worth, from ``summary.json``."""
    evaluation = summary["evaluation"]
    rooms = summary.get("rooms")
    robots = summary["robots"] if rooms is None else rooms["robots"]
    where = "" if rooms is None else f" in {rooms['count']} rooms"
    title = (
        f"{robots} robots{where}, seed {summary['seed']}, {summary['episodes']} episodes,"
        f" {summary['ticks']} ticks at {summary['steps_per_s']:.0f} steps/s"
    )
    columns = {
        "frozen, eps = .05": evaluation["eps05"],
        "greedy": evaluation["greedy"],
        "last 5 in training": evaluation["last5"],
    }
    if rooms is not None and "held_out" in rooms:
        columns["held-out rooms, greedy"] = rooms["held_out"]
    return evaluation_table(title, columns)


def show_summary(console: Console, summary: Mapping[str, Any], folder: RunFolder) -> None:
    """The end of a run: what the policy is worth and where everything is."""
    console.print(summary_table(summary))
    for path in folder.results():
        console.print(f"  {path}", **PLAIN)
