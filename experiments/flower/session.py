"""A set of processes with a private folder that end, and is removed, together with their owner."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from experiments.flower.environment import FlowerError, child_environment
from experiments.flower.guard import Guard
from repeatable.processes import Process, identify, started_apart, terminate

# Ray's socket, <folder>/ray/session_<date>_<pid>/sockets/plasma_store, must fit 103 bytes (107 on
# Linux), which leaves this much for the folder in which ours is made.
_LONGEST_ROOT = 20


class Session:
    """Starts processes that carry a marker, and ends them with all that they started.

    A watchdog process does the same should the owner die without calling `stop`. It is started
    again where it dies, and its death changes nothing else.

    Attributes:
        folder: private folder: Flower's home, Ray's files, working folder of the processes.
        environment: variables of the processes.
    """

    def __init__(self) -> None:
        """Makes the folder and starts the watchdog."""
        root = tempfile.gettempdir()
        short = root if len(root) <= _LONGEST_ROOT or not os.path.isdir("/tmp") else "/tmp"
        self.folder = Path(tempfile.mkdtemp(prefix="rf-", dir=short))
        self.marker = uuid.uuid4().hex
        self.environment = child_environment(self.folder, self.marker)
        self._children: list[subprocess.Popen[bytes]] = []
        self._roots: set[Process] = set()
        self._guard = Guard(self.marker, self.folder)

    def spawn(
        self, argv: Sequence[str], output: IO[bytes] | int, errors: int = subprocess.STDOUT
    ) -> subprocess.Popen[bytes]:
        """Starts a process in the folder, away from our terminal's signals."""
        child = started_apart(argv, self.folder, self.environment, output, errors)
        self._children.append(child)
        if (process := identify(child.pid)) is not None:
            self._roots.add(process)
            self._guard.add(process)
        return child

    def keep_guard(self) -> None:
        """Starts the watchdog anew if it has died; cheap, to be called once in a while."""
        self._guard.keep()

    def root(self, child: subprocess.Popen[bytes]) -> Process:
        """The identity of a process that `spawn` started."""
        return next(row for row in self._roots if row.pid == child.pid)

    def run(self, argv: Sequence[str], timeout_s: float) -> tuple[int, str, str]:
        """Runs a short command; returns exit status, standard output and standard error.

        Raises:
            FlowerError: it took too long; it has been ended.
        """
        child = self.spawn(argv, subprocess.PIPE, subprocess.PIPE)
        try:
            output, errors = child.communicate(timeout=timeout_s)
        except subprocess.TimeoutExpired as error:
            child.kill()
            output, errors = child.communicate()
            name = " ".join([Path(argv[0]).name, *argv[1:2]])
            message = f"`{name}` gave no answer within {timeout_s:.0f} s."
            raise FlowerError(message, (output + errors).decode(errors="replace")) from error
        return child.returncode, output.decode(errors="replace"), errors.decode(errors="replace")

    def stop(self) -> None:
        """Ends every process of the session and removes the folder; may be called again."""
        left = terminate(self.marker, self._roots, self.folder)
        for child in self._children:
            child.poll()
        shutil.rmtree(self.folder, ignore_errors=True)
        self._guard.stop()
        if left:
            numbers = ", ".join(str(row.pid) for row in sorted(left, key=lambda row: row.pid))
            raise FlowerError(f"These processes of Flower's could not be ended: {numbers}.")
