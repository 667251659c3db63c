"""Output that ends no run: where nobody takes it any more, the rest of it is left out."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import IO, Any


class Steady:
    """A stream whose failures are not the writer's: a closed pipe, a full disk, a lost terminal.

    Args:
        stream: standard output or standard error.
    """

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream
        self._lost = False

    def write(self, text: str) -> int:
        """Writes, or leaves it out."""
        if not self._lost:
            try:
                return self._stream.write(text)
            except OSError:
                self._lose()
        return len(text)

    def flush(self) -> None:
        """Passes on what is held back, or forgets it."""
        if not self._lost:
            try:
                self._stream.flush()
            except OSError:
                self._lose()

    def __getattr__(self, name: str) -> Any:
        """All else is the stream's."""
        return getattr(self._stream, name)

    def _lose(self) -> None:
        """Leads the descriptor nowhere, or what is held back would fail again at the very end."""
        self._lost = True
        with suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            try:
                os.dup2(nowhere, self._stream.fileno())
            finally:
                os.close(nowhere)


@contextmanager
def steady_output() -> Iterator[None]:
    """Makes this process's standard output and standard error steady while this lasts."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (stream and Steady(stream) for stream in before)
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
        sys.stdout, sys.stderr = before
