"""Run folders: new ones, and ones that are held."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

from conf import Config, ConfigError
from training import resume
from training.run_folder import RunFolder


def new_folder(config: Config) -> Path:
    """The folder of a run that begins now.

    Raises:
        ConfigError: ``run.dir`` is in use.
    """
    if config.run.dir is None:
        return dated(Path("runs"), f"-k{config.env.robots}-s{config.seed}")
    folder = Path(config.run.dir)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigError.of([("run.dir", folder, "a folder that is new or empty")])
    return folder


def dated(parent: Path, ending: str = "") -> Path:
    """Makes a folder that is named after the time; no other call gets it, in any process.

    Raises:
        ConfigError: it cannot be made.
    """
    stem, count = time.strftime("%Y-%m-%d_%H-%M-%S") + ending, 1
    folder = parent / stem
    try:
        parent.mkdir(parents=True, exist_ok=True)
        while True:
            with suppress(FileExistsError):
                folder.mkdir()
                return folder
            count += 1
            folder = parent / f"{stem}-{count}"
    except OSError as error:
        raise _unmade(folder, error) from error


def prepare_run(config: Config, folder: Path) -> tuple[Config, RunFolder]:
    """A configuration that names its run and says where it is, and that folder, which is made.

    Raises:
        ConfigError: it cannot be made.
    """
    folder = made(folder)
    return resume.identified(config, folder), RunFolder(folder)


def made(folder: Path) -> Path:
    """Makes a folder, if it is not there; returns its absolute path.

    Raises:
        ConfigError: it cannot be made.
    """
    folder = folder.absolute()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unmade(folder, error) from error
    return folder


def _unmade(folder: Path, error: OSError) -> ConfigError:
    return ConfigError.of([("run.dir", folder, f"a folder that can be made ({error.strerror})")])


def run_lock(folder: Path) -> AbstractContextManager[None]:
    """Holds a run's folder, so that no second process goes on in it.

    Raises:
        ConfigError: another process holds it.
    """
    return folder_lock(folder, ("run.dir", folder, "a folder in which no run is going on"))


def check_unlocked(folder: Path) -> None:
    """Checks that no run is going on in a folder, there or not.

    Raises:
        ConfigError: one is.
    """
    if folder.is_dir():
        with run_lock(folder):
            pass


@contextmanager
def folder_lock(folder: Path, problem: tuple[str, object, str]) -> Iterator[None]:
    """Holds a folder for this process.

    Args:
        folder: an existing one.
        problem: key, value and what is allowed, should another process hold it.

    Raises:
        ConfigError: another process does.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ConfigError.of([problem]) from error
        yield
    finally:
        os.close(handle)
