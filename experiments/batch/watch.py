"""What the user sees of many runs at once."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from conf import Config
from experiments.batch.states import cost_s, folder_of
from experiments.console import PLAIN
from experiments.console.display import RUNNING, Showing, share_done
from experiments.console.screen import Cell
from experiments.runtimes.stopping import ShieldedSignals
from training.run_folder import RunFolder

POLL_S = 0.5
LINE_PERIOD_S = 30.0
SURE = 0.02
"""The share of all work after which the time that is left can be guessed."""


class Watch(Showing):
    """Shows how far all runs are, from what they write, and looks after signals meanwhile.

    A bar on a terminal; elsewhere a plain line every half minute. ``done`` runs were done before.
    """

    def __init__(
        self, done: int, left: Sequence[Config], signals: ShieldedSignals, console: Console
    ) -> None:
        super().__init__("watch")
        self._done, self._signals, self._console = done, signals, console
        self._costs_s = {folder_of(config): cost_s(config) for config in left}
        self._episodes = sum(config.train.episodes for config in left)
        self._began, self._began_at = time.monotonic(), time.time()
        self._before_s = self._worked_s(self._read())

    def _run(self) -> None:
        try:
            self._draw()
        finally:  # nobody else takes a signal
            while not self._ended.wait(POLL_S):
                self._signals.look()

    def _draw(self) -> None:
        columns = (BarColumn(40), TextColumn("{task.description}"), TimeElapsedColumn())
        terminal, cell = self._console.is_terminal, Cell() if self._console.is_jupyter else None
        with Progress(*columns, console=self._console, transient=True, disable=not terminal) as bar:
            task = bar.add_task("", total=sum(self._costs_s.values()))
            printed = time.monotonic()
            while not self._ended.wait(POLL_S):
                self._signals.look()
                statuses = self._read()
                line = self._line(statuses)
                bar.update(task, completed=self._worked_s(statuses), description=line)
                if cell is not None:
                    cell.show(Text(line))
                elif not terminal and time.monotonic() - printed >= LINE_PERIOD_S:
                    printed = time.monotonic()
                    self._console.print(line, **PLAIN)
            if cell is not None:
                cell.show(Text(self._line(self._read())))

    def _read(self) -> dict[Path, dict[str, Any]]:
        """What runs last wrote; those that are still to go on are in the state "stopped"."""
        found = {}
        for folder in self._costs_s:
            status = RunFolder(folder).read_progress()
            if status is not None:
                before = (status["written_at"] or 0.0) < self._began_at
                found[folder] = status | ({"state": "stopped"} if before else {})
        return found

    def _worked_s(self, statuses: Mapping[Path, dict[str, Any]]) -> float:
        """The guessed processor time of what is done."""
        return sum(self._costs_s[folder] * share_done(s) for folder, s in statuses.items())

    def _line(self, statuses: Mapping[Path, dict[str, Any]]) -> str:
        """Where all runs are, in a line."""
        states = [status["state"] for status in statuses.values()]
        text = (
            f"runs {self._done + states.count('done')}/{self._done + len(self._costs_s)},"
            f" {sum(state in RUNNING for state in states)} going,"
            f" episodes {sum(s['episode'] for s in statuses.values())}/{self._episodes}"
        )
        if failed := states.count("failed"):
            text += f", {failed} failed"
        total_s, worked_s = sum(self._costs_s.values()), self._worked_s(statuses)
        since_s = worked_s - self._before_s
        if since_s > SURE * total_s and not self._ended.is_set():
            seconds = (total_s - worked_s) / since_s * (time.monotonic() - self._began)
            text += f", about {max(seconds / 60, 1):.0f} min left"
        return text
