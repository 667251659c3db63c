"""Files that appear whole or not at all, and errors that say which file they are about."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


def write_whole(path: Path, content: bytes) -> None:
    """Puts a file in its place so that it appears whole or not at all, and outlasts a crash.

    Raises:
        OSError: it cannot be written; nothing of it is left, and the message names the file.
    """
    _put(path, path.with_suffix(f".{os.getpid()}.writing"), content, durable=True)
    with naming(path):
        handle = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def write_atomically(path: Path, text: str, *, durable: bool = True) -> None:
    """Writes a text file so that a reader sees either the old or the new one.

    If it is to be durable, it outlasts a crash of the machine.

    Raises:
        OSError: as ``write_whole``.
    """
    _put(path, path.with_name(f".{path.name}.{os.getpid()}"), text.encode(), durable=durable)


def _put(path: Path, written: Path, content: bytes, *, durable: bool) -> None:
    """Writes a file elsewhere and moves it to its place."""
    try:
        with naming(path):
            with written.open("wb") as file:
                file.write(content)
                file.flush()
                if durable:
                    os.fsync(file.fileno())
            written.replace(path)
    except OSError:
        with suppress(OSError):  # what was half written would keep a full disk full
            written.unlink(missing_ok=True)
        raise


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Lets an error of the system say which file it is about: that of a full disk does not."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error
