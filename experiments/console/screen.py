"""Where a run is shown: on a terminal, in a notebook's cell, to a function, or nowhere."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Self

from rich.console import Console, RenderableType
from rich.text import Text

from experiments.console.display import Display, Showing, panel
from training.run_folder import RunFolder

Reporter = Callable[[dict[str, Any]], object]
"""Takes what a run last said of its progress, see ``RunFolder.read_progress``."""


@dataclass(frozen=True)
class Screen:
    """How a run is shown.

    Attributes:
        console: where all is printed that is said once.
        display: shows the run's progress while it is entered.
        in_notebook: whether it is a cell, where a run is an object that knows its folder and
            shows what it is worth.
    """

    console: Console = field(default_factory=Console)
    display: Callable[[RunFolder, Console], AbstractContextManager[object]] = Display
    in_notebook: bool = False


def screen_of(progress: bool | Reporter) -> Screen:
    """The screen of a terminal or notebook if True, none if False, or a function's.

    The function is called with the progress.
    """
    if callable(progress):
        return Screen(Console(quiet=True), partial(Reports, progress))
    if not progress:
        return Screen(Console(quiet=True), lambda folder, console: nullcontext())
    console = Console()
    return Screen(console, CellDisplay, True) if console.is_jupyter else Screen(console)


class Cell:
    """An output of a notebook's cell that changes in its place."""

    def __init__(self) -> None:
        self._handle: Any = None

    def show(self, what: RenderableType) -> None:
        """Shows something of ``rich`` in the place of what was shown before."""
        from IPython.display import display  # there, since a notebook is

        if self._handle is None:
            self._handle = display(what, display_id=True)  # type: ignore[no-untyped-call]
        else:
            self._handle.update(what)


class CellDisplay(Showing):
    """Shows a run's progress in a notebook's cell, where its last state stays; needs no console."""

    def __init__(self, folder: RunFolder, console: Console) -> None:
        super().__init__("cell")
        self._folder, self._cell = folder, Cell()

    def __enter__(self) -> Self:
        """Takes its place in the cell that is running now, and begins to show."""
        self._cell.show(Text("starting"))
        return super().__enter__()

    def _run(self) -> None:
        for status, _ in self._statuses(self._folder):
            self._cell.show(panel(status))


class Reports(Showing):
    """Tells a function how a run goes on, whenever that changes, and at its end."""

    def __init__(self, tell: Reporter, folder: RunFolder, console: Console) -> None:
        super().__init__("reports")
        self._tell, self._folder = tell, folder

    def _run(self) -> None:
        told = None
        for status, _ in self._statuses(self._folder):
            if status != told:
                told = status
                self._tell(dict(status))
