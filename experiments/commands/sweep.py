"""``risfleet train -m``: a run for each combination of values."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

from hydra.core.override_parser.types import Override
from rich.console import Console

from conf import Config, ConfigError
from conf.overrides import combinations, is_hydras, lines, parse
from conf.user_paths import pasted
from experiments.batch import train as batch
from experiments.batch.launcher import build_launcher
from experiments.batch.states import check_folder, folder_of
from experiments.console.plain import PLAIN
from experiments.runtimes.folders import check_unlocked, dated, made, run_lock
from experiments.runtimes.runner import ERRORS, print_error, train_missing
from training.preflight import checked_training
from training.run_folder import RunFolder

DIR = "run.dir"
BASIC = "hydra/launcher=basic"
HYDRAS = "multirun.yaml"
"""What Hydra leaves in a sweep's folder."""


def train_all(overrides: Sequence[str]) -> int:
    """Runs every combination of a sweep, all of them checked before the first one starts.

    Without a launcher they follow one another in this process. In a folder that holds this sweep
    already, runs that have ended are left as they are, and those that have begun go on.

    Args:
        overrides: some of them with several values.

    Returns:
        The exit status: 0, 1 where a run failed, or that of the signal that ended the runs early.
    """
    parsed = parse(overrides, sweep=True, launcher=True)
    launcher = lines([item for item in parsed if is_hydras(item)])
    runs = [item for item in parsed if not is_hydras(item) and item.key_or_group != DIR]
    configs = [checked_training(combination) for combination in combinations(runs)]
    folder = _folder([item for item in parsed if item.key_or_group == DIR])
    if folder is not None:
        configs = _numbered(configs, folder)
        _check_unused(folder, configs)
    shown = launcher in ([], [BASIC])
    if not shown:
        build_launcher(print, launcher, folder or Path(), 1)  # a mistake leaves no folder behind
    if folder is None:
        folder = dated(Path("multirun"))
        configs = _numbered(configs, folder)
    folder = made(folder)
    with run_lock(folder):
        return _one_by_one(configs) if shown else _at_once(configs, folder, launcher)


def _one_by_one(configs: Sequence[Config]) -> int:
    status = 0
    for config in configs:
        try:
            ended = train_missing(config)
        except ERRORS as error:  # what fails leaves the others to go on
            print_error(error)
            status = 1
        else:
            if ended:
                return ended
    return status


def _at_once(configs: Sequence[Config], folder: Path, launcher: Sequence[str]) -> int:
    console = Console()
    console.print(f"sweep folder: {folder}", **PLAIN)
    outcome = batch.train(configs, folder, console, launcher)
    for run, why in outcome.failed.items():
        print(f"risfleet: {run} failed: {why}", file=sys.stderr)
    if outcome.signal:
        again = f"the same command with {pasted(DIR, folder)}"
        console.print(f"Stopped early by {outcome.signal}. To go on: {again}", **PLAIN)
    elif not outcome.status:
        console.print(f"all {len(outcome.done)} runs are there", highlight=False)
    return outcome.status


def _folder(given: Sequence[Override]) -> Path | None:
    """The sweep's folder, None for a new one."""
    value = given[-1].value() if given else None
    if value is None:
        return None
    if "${" in str(value):
        raise ConfigError.of([(DIR, value, "one folder for the whole sweep")])
    return Path(str(value)).absolute()


def _numbered(configs: Sequence[Config], folder: Path) -> list[Config]:
    """The configurations of runs in folders 0, 1, ... of a sweep's."""
    return [
        dataclasses.replace(c, run=dataclasses.replace(c.run, dir=str(folder / str(number))))
        for number, c in enumerate(configs)
    ]


def _check_unused(folder: Path, configs: Sequence[Config]) -> None:
    """Checks that a folder is free for a sweep, or holds it.

    Raises:
        ConfigError: it holds something else.
    """
    held = set(folder.iterdir()) if folder.is_dir() else set()
    runs = {path for path in held if path.name.isdigit() and path.is_dir()}
    left = {RunFolder(folder).stop_file, folder / HYDRAS}
    if (folder.exists() and not folder.is_dir()) or held - runs - left:
        raise ConfigError.of([(DIR, folder, "a folder that is new or empty, or of this sweep")])
    for config in configs:
        check_unlocked(folder_of(config))
        check_folder(config)
