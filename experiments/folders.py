"""The folders of runs: a new one, and one that no two processes work in."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from conf import Config, ConfigError


def new_folder(config: Config) -> Path:
    """The folder of a run that begins now.

    Raises:
        ConfigError: ``run.dir`` is in use.
    """
    if config.run.dir is None:
        stem = f"{time.strftime('%Y-%m-%d_%H-%M-%S')}-k{config.env.robots}-s{config.seed}"
        folder, count = Path("runs") / stem, 1
        while folder.exists():
            count += 1
            folder = Path("runs") / f"{stem}-{count}"
        return folder
    check_unused(Path(config.run.dir))
    return Path(config.run.dir)


def check_unused(folder: Path) -> None:
    """Checks that a folder for runs is new or empty.

    Raises:
        ConfigError: it is not.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigError.of([("run.dir", folder, "a folder that is new or empty")])


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Holds a run's folder, so that no second process goes on in it.

    Raises:
        ConfigError: another process holds it.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            say = "a folder in which no run is going on"
            raise ConfigError.of([("run.dir", folder, say)]) from error
        yield
    finally:
        os.close(handle)
