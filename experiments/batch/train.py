"""Trains what many runs still miss, with every core, and goes on where they stopped."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from conf import Config
from experiments.batch.launcher import build_launcher
from experiments.batch.states import State, cost_s, folder_of, state_of
from experiments.batch.watch import Watch
from experiments.batch.worker import Work
from experiments.console import PLAIN
from experiments.console.mishaps import in_words
from experiments.runtimes.folders import check_unlocked, run_lock
from experiments.runtimes.stopping import ShieldedSignals
from training.run_folder import RunFolder

ATTEMPTS = 2
"""A process that dies takes its launcher's other jobs with it, so these are launched again."""


@dataclass(frozen=True)
class BatchOutcome:
    """What became of all runs.

    Attributes:
        done: folders of the runs that are there.
        failed: why the others are not, by folder; empty after a signal.
        status: the exit status: 0, 1 where a run failed, 130 or 143 after a signal.
        signal: what has ended the runs early, in words; empty if nothing has.
    """

    done: tuple[Path, ...]
    failed: Mapping[Path, str]
    status: int
    signal: str = ""


def train(
    configs: Sequence[Config],
    store: Path,
    console: Console,
    hydra: Sequence[str] = (),
    workers: int | None = None,
    *,
    empties: bool = False,
) -> BatchOutcome:
    """Trains every run that is not done; the longest ones begin first.

    Args:
        configs: checked ones with ``run.dir``; equal folders are trained once.
        store: an existing folder, which the caller holds, for the file that stops all runs.
        console: where to show progress.
        hydra: overrides of Hydra's launcher.
        workers: processes at once; as many as cores if None.
        empties: whether a folder with what cannot be used is emptied.

    Raises:
        ConfigError: the launcher is wrong, or a run is going on in another process.
    """
    workers = workers or _cores()
    runs = {folder_of(config): config for config in configs}
    states = {folder: state_of(config) for folder, config in runs.items()}
    left = [folder for folder, state in states.items() if state is not State.DONE]
    for folder in left:
        check_unlocked(folder)
    files = [RunFolder(folder).stop_file for folder in (store, *left)]
    with ShieldedSignals(files, console) as signals:
        failed: dict[Path, str] = {}
        for _ in range(ATTEMPTS):
            if not left or signals.asked:
                break
            for folder in left:
                _clear(folder, empties=empties and states[folder] is State.NEW)
            done = sum(state is State.DONE for state in states.values())
            missing = sorted((runs[folder] for folder in left), key=cost_s, reverse=True)
            _launch(missing, done, store, workers, hydra, signals, console)
            states = {folder: state_of(config) for folder, config in runs.items()}
            left = [folder for folder, state in states.items() if state is not State.DONE]
            failed = {each: why for each in left if (why := RunFolder(each).failure) is not None}
            left = [folder for folder in left if folder not in failed]
    ended = tuple(folder for folder, state in states.items() if state is State.DONE)
    if signals.asked:
        return BatchOutcome(ended, {}, signals.status, signals.name)
    lost = {folder: "it did not end" for folder in runs if folder not in ended}
    return BatchOutcome(ended, lost | failed, int(bool(lost)))


def _cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _clear(folder: Path, *, empties: bool) -> None:
    """Removes what an earlier attempt said of its end; or all that a folder holds."""
    if empties and folder.exists():
        with run_lock(folder):
            shutil.rmtree(folder)
    elif RunFolder(folder).failure is not None:
        RunFolder(folder).progress_file.unlink()


def _launch(
    missing: Sequence[Config],
    done: int,
    store: Path,
    workers: int,
    hydra: Sequence[str],
    signals: ShieldedSignals,
    console: Console,
) -> None:
    """Hands runs to Hydra's launcher and waits until all have ended."""
    console.print(f"{len(missing)} runs to train, {done} done before; {store}", **PLAIN)
    work = Work(tuple(missing), RunFolder(store).stop_file, os.getpid())
    launcher = build_launcher(work, hydra, store, workers)
    with Watch(done, missing, signals, console):
        try:
            launcher.launch([[f"seed={each.seed}"] for each in missing], initial_job_idx=0)
        except Exception as error:  # a launcher's own: its processes were killed, its cluster left
            console.print(f"risfleet: {type(error).__name__}: {in_words(error)}".splitlines()[0])
