"""Keeps a watchdog beside a session: should its owner die, the watchdog ends what it started."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from experiments.flower import variables
from repeatable.processes import MARKER, Process, table

_MOST_STARTS = 10
"""A watchdog that dies as often as that cannot live here: the session goes on without."""
_LAST_S = 10.0


class Guard:
    """A session's watchdog, started again where it died. Nothing that befalls it is an error."""

    def __init__(self, marker: str, folder: Path) -> None:
        self._arguments = [marker, str(folder)]
        self._roots: set[Process] = set()
        self._process: subprocess.Popen[bytes] | None = None
        self._starts = 0
        self._ended = False
        self.keep()

    def add(self, root: Process) -> None:
        """Adds a process that the watchdog must end."""
        self._roots.add(root)
        if not self.keep():
            self._tell([root])

    def keep(self) -> bool:
        """Starts the watchdog unless it is there; whether it did."""
        alive = self._process is not None and self._process.poll() is None
        if alive or self._ended or self._starts >= _MOST_STARTS:
            return False
        self._starts += 1
        self._close()
        with suppress(OSError):
            self._process = self._started()
            there = table()
            self._roots = {root for root in self._roots if there.get(root.pid) == root}
            self._tell(self._roots)
        return True

    def stop(self) -> None:
        """Ends the watchdog; may be called again."""
        self._ended = True
        self._close()
        if self._process is not None:
            try:
                self._process.wait(timeout=_LAST_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def _started(self) -> subprocess.Popen[bytes]:
        own = {name: value for name, value in variables.chosen().items() if name != MARKER}
        process = subprocess.Popen(
            # -P: a folder `experiments` where the user happens to be must not be taken for ours.
            [sys.executable, "-P", "-m", f"{__package__}.watchdog", *self._arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=own,
            start_new_session=True,
            bufsize=0,  # a line goes out whole or not at all, and none is left for the end
        )
        assert process.stdin is not None
        os.set_blocking(process.stdin.fileno(), False)  # one that stands still holds up nobody
        return process

    def _tell(self, roots: Iterable[Process]) -> None:
        if self._process is not None and self._process.stdin is not None:
            with suppress(OSError, ValueError):  # it died or was ended: the next look sees it
                for root in roots:
                    self._process.stdin.write(f"{root.pid}\t{root.started}\n".encode())

    def _close(self) -> None:
        if self._process is not None and self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()
