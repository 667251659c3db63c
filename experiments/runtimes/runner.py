"""Runs as the command line starts them: a folder each, progress, and what ends them early."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from conf import Config, ConfigError
from env.plugins import PluginError
from experiments.console import PLAIN
from experiments.console.display import show_summary
from experiments.console.mishaps import in_words
from experiments.console.notices import notices
from experiments.console.screen import Screen
from experiments.flower.environment import FlowerError
from experiments.runtimes import local, on_flower
from experiments.runtimes.folders import new_folder, prepare_run, run_lock
from experiments.runtimes.stopping import StopSignals
from lockstep import LinkError
from storage.checkpoint_files import CheckpointError, checkpoints
from storage.checkpoint_layout import server_folder
from training import resume
from training.addresses import check_address
from training.checkpoint import Checkpoint
from training.preflight import checked_training
from training.run_folder import RunFolder

ERRORS = (ConfigError, PluginError, FlowerError, LinkError, CheckpointError, OSError)
"""What ends a run with a sentence: a mistake, or a machine, disk or network that fails."""

Runtime = Callable[[Config, RunFolder, Checkpoint | None], dict[str, Any]]
RUNTIMES: dict[str, Runtime] = {
    "local": local.train,
    "simulation": on_flower.train,
    "deployment": on_flower.train,
}


def print_error(error: Exception) -> int:
    """Prints what ended a run, or kept it from starting, and its notes; returns the exit status."""
    notes = getattr(error, "__notes__", [])
    print(f"risfleet: {in_words(error)}", *notes, sep="\n", file=sys.stderr)
    return 2 if isinstance(error, ConfigError | PluginError) else 1


def planned(overrides: Sequence[str]) -> tuple[Config, Path, Checkpoint | None]:
    """The run that overrides describe, checked; or the one that ``resume=RUN`` names.

    Returns:
        The arguments of ``train``.

    Raises:
        ConfigError: a mistake of the user's, or a folder that is in use.
    """
    checkpoint = None
    if resumes := resume.asked(overrides):
        config, checkpoint = resume.read(overrides)
    else:
        config = checked_training(overrides)
    if config.runtime.connection is None:  # else it is another machine's
        check_address(config)
    return config, RunFolder.of(config).path if resumes else new_folder(config), checkpoint


def train(
    config: Config,
    folder: Path,
    resumed: Checkpoint | None = None,
    screen: Screen | None = None,
) -> StopSignals:
    """Trains one run and shows it, as on a command line if there is no screen.

    Args:
        config: a checked configuration.
        folder: the run's folder, new or empty unless it goes on.
        resumed: where the run goes on, if it does not begin.
        screen: how it is shown.

    Returns:
        Whether a signal ended the run early.
    """
    screen = screen or Screen()
    config, own = _shown(config, folder, screen)
    with run_lock(own.path):
        if resumed is not None:
            own.clear()
        return _train_shown(config, own, resumed, screen)


def train_missing(config: Config, screen: Screen | None = None) -> StopSignals | None:
    """Trains and shows what the run in ``run.dir`` still misses, which may be all or nothing.

    Returns:
        See ``train``; None if nothing was missing.

    Raises:
        ConfigError: the folder holds another run, or another process goes on in it.
    """
    screen = screen or Screen()
    config, folder = _shown(config, RunFolder.of(config).path, screen)
    with run_lock(folder.path):
        config, found = _ready(config, folder)
        if isinstance(found, dict):
            screen.console.print("done before", highlight=False)
            return None
        return _train_shown(config, folder, found, screen)


def train_quietly(config: Config) -> dict[str, Any]:
    """Trains what the run in ``run.dir`` still misses, and shows nothing.

    Returns:
        What ``summary.json`` holds.

    Raises:
        ConfigError: the folder holds another run, or another process goes on in it.
    """
    config, folder = prepare_run(config, RunFolder.of(config).path)
    with run_lock(folder.path):
        try:
            config, found = _ready(config, folder)
            if isinstance(found, dict):
                return found
            return RUNTIMES[config.runtime.name](config, folder, found)
        except Exception as error:
            folder.report_failure(error)
            raise


def _ready(config: Config, folder: RunFolder) -> tuple[Config, dict[str, Any] | Checkpoint | None]:
    """What a run has come to, or where it goes on, its folder made ready for that.

    Returns:
        The configuration, with the identity that the run has had so far, and what
        ``resume.find_run_state`` says.
    """
    found = resume.find_run_state(config, folder)
    if not isinstance(found, dict):
        folder.clear(whole=found is None)
    if isinstance(found, Checkpoint):
        identity = found.meta.get("run")
        config = dataclasses.replace(config, run=dataclasses.replace(config.run, id=identity))
    return config, found


def _train_shown(
    config: Config, folder: RunFolder, resumed: Checkpoint | None, screen: Screen
) -> StopSignals:
    """Trains a run whose folder is held, with progress and signals."""
    console = screen.console
    if resumed is not None:
        for reason in resumed.passed_over:
            console.print(f"passed over: {reason}", **PLAIN)
        console.print(f"going on from window {resumed.window}", highlight=False)
    with StopSignals([folder.stop_file], console) as stop, screen.display(folder, console):
        try:
            summary = RUNTIMES[config.runtime.name](config, folder, resumed)
        except ERRORS as error:
            if checkpoints(server_folder(folder.state)):
                error.add_note(f"To go on: {resume.how(folder.path)}")
            raise
    if not summary:
        console.print("The run has ended; its folder is on the machine of the ServerApp.")
    elif not screen.in_notebook:
        show_summary(console, summary, folder)
    if stop.asked:
        say = "what was learned until then is in the run folder"
        console.print(f"Stopped early by {stop.name}: {say}.")
    return stop


def _shown(config: Config, folder: Path, screen: Screen) -> tuple[Config, RunFolder]:
    """See ``prepare_run``; says where the run is."""
    config, own = prepare_run(config, folder)
    if not screen.in_notebook:
        screen.console.print(f"run folder: {own}", **PLAIN)
    for line in notices(config):
        screen.console.print(f"note: {line}", **PLAIN)
    return config, own
