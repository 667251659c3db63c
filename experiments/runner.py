"""Runs as the command line starts them: a folder each, progress, and Ctrl-C."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from rich.console import Console

from agent import checkpoints
from conf import Config, ConfigError
from conf.places import STATE, server_folder
from env.link import LinkError
from env.plugins import PluginError
from experiments import local, on_flower, together
from experiments.display import Display, show_summary
from experiments.flower import FlowerError
from experiments.folders import alone, clear, placed
from experiments.mishaps import in_words
from server_app import resume
from server_app.checkpoint import Checkpoint
from server_app.session import STOP_FILE

INTERRUPTED = 130
ERRORS = (ConfigError, PluginError, FlowerError, LinkError, OSError)
"""What ends a run with a sentence: a mistake, or a machine, disk or network that fails."""

Runtime = Callable[[Config, Path, Checkpoint | None], dict[str, Any]]
RUNTIMES: dict[str, Runtime] = {
    "local": local.train,
    "simulation": on_flower.train,
    "deployment": on_flower.train,
}


def say(error: Exception) -> int:
    """Prints what ended a run or kept it from starting; returns the exit status.

    How to go on is said, too, where it is known.
    """
    print(
        f"risfleet: {in_words(error)}", *getattr(error, "__notes__", []), sep="\n", file=sys.stderr
    )
    return 2 if isinstance(error, ConfigError | PluginError) else 1


def train(config: Config, folder: Path, resumed: Checkpoint | None = None) -> int:
    """Trains one run and shows it.

    Args:
        config: a checked configuration.
        folder: the run's folder, new or empty unless it goes on.
        resumed: where the run goes on, if it does not begin.

    Returns:
        0, or 130 if Ctrl-C ended the run early.
    """
    console = Console()
    config, folder = _shown(config, folder, console)
    with alone(folder):
        if resumed is not None:
            for reason in resumed.passed_over:
                console.print(f"passed over: {reason}", highlight=False, soft_wrap=True)
            console.print(f"going on from window {resumed.window}", highlight=False)
            clear(folder)
        with StopOnInterrupt([folder], console) as stop, Display([folder], console):
            try:
                summary = RUNTIMES[config.runtime.name](config, folder, resumed)
            except ERRORS as error:
                if checkpoints(server_folder(folder / STATE)):
                    error.add_note(f"To go on: risfleet train {resume.PREFIX}{folder}")
                raise
    if summary:
        show_summary(console, summary, folder)
    else:
        console.print("The run has ended; its folder is on the machine of the ServerApp.")
    return _ended(stop, console)


def train_together(runs: Sequence[tuple[Config, Path]]) -> int:
    """Trains runs side by side in this process and shows them; one that fails says why.

    They follow one another where they have nothing to share.

    Args:
        runs: checked configurations that differ in nothing but their seeds, and new folders.

    Returns:
        0, 1 if a run failed, or 130 if Ctrl-C ended them early.
    """
    if len(runs) == 1 or not together.can_share(runs[0][0]):
        return _one_by_one(runs)
    console = Console()
    configs, folders = zip(*(_shown(*run, console) for run in runs), strict=True)
    with StopOnInterrupt(folders, console) as stop, Display(folders, console):
        endings = together.train(configs, folders)
    status = 0
    for ending, folder in zip(endings, folders, strict=True):
        if not isinstance(ending, Exception):
            show_summary(console, ending, folder)
        elif isinstance(ending, ERRORS):
            status = max(status, say(ending))
        else:
            raise ending
    return _ended(stop, console) or status


def _one_by_one(runs: Sequence[tuple[Config, Path]]) -> int:
    """The same, one after the other."""
    statuses = [0]
    for run in runs:
        try:
            status = train(*run)
        except ERRORS as error:
            say(error)
            status = 1
        if status == INTERRUPTED:
            return status
        statuses.append(status)
    return max(statuses)


def _shown(config: Config, folder: Path, console: Console) -> tuple[Config, Path]:
    """See ``placed``; says where the run is."""
    config, folder = placed(config, folder)
    console.print(f"run folder: {folder}", highlight=False, soft_wrap=True)
    return config, folder


def _ended(stop: StopOnInterrupt, console: Console) -> int:
    if stop.asked:
        console.print("Stopped early by Ctrl-C: what was learned until then is in the run folder.")
    return INTERRUPTED if stop.asked else 0


class StopOnInterrupt:
    """Ctrl-C asks runs to end at their next aggregation; a second one ends them at once.

    Args:
        folders: the runs'.
        console: where to say so.
    """

    def __init__(self, folders: Sequence[Path], console: Console) -> None:
        self._files, self._console = [folder / STOP_FILE for folder in folders], console
        self.asked = False

    def __enter__(self) -> StopOnInterrupt:
        """Takes Ctrl-C over."""
        self._forget()  # those of runs that were killed
        self._before = signal.signal(signal.SIGINT, self._on_interrupt)
        return self

    def __exit__(self, *error: object) -> None:
        """Gives Ctrl-C back."""
        signal.signal(signal.SIGINT, self._before)
        self._forget()

    def _forget(self) -> None:
        for file in self._files:
            file.unlink(missing_ok=True)

    def _on_interrupt(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
        for file in self._files:
            file.touch()
        self._console.print("Stopping at the next aggregation; Ctrl-C again stops at once.")
