"""A sweep: a run for each combination of values, in one folder, and again what is missing."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from hydra.core.override_parser.types import Override

from conf import Config, ConfigError
from conf.overrides import combinations, is_hydras, lines, parse
from experiments.batch.launcher import build_launcher
from experiments.batch.states import check_folder, folder_of
from experiments.batch.train import BatchOutcome
from experiments.console.mishaps import in_words
from experiments.console.screen import Screen
from experiments.runtimes.folders import check_unlocked, dated, made, run_lock
from experiments.runtimes.runner import ERRORS, train_missing
from training.preflight import checked_training
from training.run_folder import RunFolder

DIR = "run.dir"
HYDRAS = "multirun.yaml"
"""What Hydra leaves in a sweep's folder."""


@dataclasses.dataclass(frozen=True)
class Sweep:
    """The runs of a sweep, all of them checked.

    Attributes:
        configs: of each run, in its folder.
        folder: an existing one, which holds all of theirs, and is held for this process.
        launcher: the overrides of Hydra's launcher.
    """

    configs: Sequence[Config]
    folder: Path
    launcher: Sequence[str]


@contextmanager
def planned_sweep(overrides: Sequence[str]) -> Iterator[Sweep]:
    """The runs that overrides describe, none of which has been started, while it is entered.

    Args:
        overrides: some of them with several values.

    Raises:
        ConfigError: a mistake in any combination, or a folder that holds something else.
    """
    parsed = parse(overrides, sweep=True, launcher=True)
    launcher = lines([item for item in parsed if is_hydras(item)])
    runs = [item for item in parsed if not is_hydras(item) and item.key_or_group != DIR]
    configs = [checked_training(combination) for combination in combinations(runs)]
    folder = sweep_folder([item for item in parsed if item.key_or_group == DIR])
    if folder is not None:
        configs = _numbered(configs, folder)
        _check_unused(folder, configs)
    if launcher:
        build_launcher(print, launcher, folder or Path(), 1)  # a mistake leaves no folder behind
    if folder is None:
        folder = dated(Path("multirun"))
        configs = _numbered(configs, folder)
    folder = made(folder)
    with run_lock(folder):
        yield Sweep(configs, folder, launcher)


def train_in_turn(
    configs: Sequence[Config], screen: Screen, on_failure: Callable[[Exception], object]
) -> BatchOutcome:
    """Trains what is missing of checked runs with ``run.dir``, one after the other.

    ``on_failure`` is told what a run failed of; the others go on.
    """
    done: list[Path] = []
    failed: dict[Path, str] = {}
    for config in configs:
        try:
            stop = train_missing(config, screen)
        except ERRORS as error:
            on_failure(error)
            failed[folder_of(config)] = in_words(error)
        else:
            if stop is not None and stop.asked:
                return BatchOutcome(tuple(done), {}, stop.status, stop.name)
            done.append(folder_of(config))
    return BatchOutcome(tuple(done), failed, int(bool(failed)))


def sweep_folder(given: Sequence[Override]) -> Path | None:
    """The sweep's folder by overrides of ``run.dir``, None for a new one.

    Raises:
        ConfigError: it is one for each run.
    """
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


def holds_runs_alone(folder: Path, files: Collection[str]) -> bool:
    """Whether a folder is not there yet, or holds numbered folders and such files alone."""
    if not folder.is_dir():
        return not folder.exists()
    return all(
        path.name in files or (path.name.isdigit() and path.is_dir()) for path in folder.iterdir()
    )


def _check_unused(folder: Path, configs: Sequence[Config]) -> None:
    """Raises a ``ConfigError`` where a folder is neither free for a sweep nor holds it."""
    if not holds_runs_alone(folder, {RunFolder(folder).stop_file.name, HYDRAS}):
        raise ConfigError.of([(DIR, folder, "a folder that is new or empty, or of this sweep")])
    for config in configs:
        check_unlocked(folder_of(config))
        check_folder(config)
