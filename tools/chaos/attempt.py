"""One process of ``risfleet train`` that is watched, struck and seen to its end."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from repeatable.process_tracker import LAUNCHER, MARK, Deck, ProcessTracker, aim
from repeatable.processes import Process, command
from tools.chaos.kill_points import WRITING, KillPoint, Watched
from tools.chaos.tasks import ROBOTS, ROLES, WATCHDOG, Runtime

ROOT = Path(__file__).parents[2]
HUNG = -1000
"""The status of a launcher that did not end."""

_LOOK_S = 0.01
_UNGUARDED_S = 10.0  # a session looks after its watchdog about once a second
_STARE_S = 0.0002  # a checkpoint is written in a few milliseconds


@dataclass
class Hit:
    """A kill that happened.

    Attributes:
        moment: what was waited for.
        role: of the process that was killed.
        window: the newest window that the server had a checkpoint of.
        at: when, on the monotonic clock, in s.
        further_s: seconds until the server had a later checkpoint, None if it never had.
    """

    moment: KillPoint
    role: str
    window: int
    at: float
    further_s: float | None = None


@dataclass
class AttemptOutcome:
    """How a process came to its end.

    Attributes:
        status: the launcher's; negative for a signal, `HUNG` if it had to be ended.
        printed: its standard output.
        errors: its standard error.
        hits: the kills.
        ended_s: seconds from the last kill to the launcher's end.
        gone_s: seconds from there to the end of every other process.
        left: command lines of processes that had to be ended.
    """

    status: int
    printed: str
    errors: str
    hits: list[Hit]
    ended_s: float
    gone_s: float
    left: list[str] = field(default_factory=list)


class Attempt:
    """Starts the command on entry; on exit none of its processes is left.

    Args:
        given: the command's arguments behind `train`.
        folder: the run's folder.
        scratch: a folder with a short path for files that the command makes elsewhere.
        runtime: its limits.
    """

    def __init__(self, given: Sequence[str], folder: Path, scratch: Path, runtime: Runtime) -> None:
        self._given, self._folder, self._scratch = list(given), folder, scratch
        self._runtime = runtime
        self._hits: list[Hit] = []

    def __enter__(self) -> Attempt:
        """Starts the command."""
        mark = uuid.uuid4().hex
        paths = filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])
        extra = {MARK: mark, "TMPDIR": str(self._scratch), "PYTHONPATH": os.pathsep.join(paths)}
        self._printed = self._scratch / f"out-{mark}"
        self._errors = self._scratch / f"err-{mark}"
        self._began, since = time.monotonic(), time.time()
        with self._printed.open("w") as printed, self._errors.open("w") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "experiments.cli", "train", *self._given],
                stdin=subprocess.DEVNULL,
                stdout=printed,
                stderr=errors,
                cwd=self._scratch,
                env=os.environ | extra,
                start_new_session=True,
            )
        self._crowd = ProcessTracker(self._process.pid, mark, ROLES)
        self._watched = Watched(self._folder, ROBOTS, since)
        return self

    def __exit__(self, *error: object) -> None:
        """Ends whatever is left."""
        self._crowd.end()
        self._process.wait()

    def strike(self, moment: KillPoint, deck: Deck) -> bool:
        """Waits for a moment and kills a process; False if the command ended before.

        Args:
            moment: when.
            deck: whom.
        """
        if not self._wait(lambda: self._watched.reached(moment)):
            return False
        due = time.monotonic() + moment.delay_s
        if not self._wait(lambda: time.monotonic() >= due):
            return False
        while (victim := deck.pick(self._targets())) is None:  # nobody of those is there yet
            if not self._is_running():
                return False
            time.sleep(_LOOK_S)
        role, process = victim
        if (target := aim(process)) is None:
            return False
        if moment.kind == WRITING:
            self._wait(self._watched.is_writing, _STARE_S)
        window = self._watched.checkpoint()
        if not target.kill():
            return False
        self._hits.append(Hit(moment, role, window, time.monotonic()))
        return True

    def finish(self) -> AttemptOutcome:
        """Waits for the launcher's end, and for that of all other processes."""
        while self._is_running():
            if time.monotonic() - self._began > self._runtime.patience_s:
                break
            self._look_further()
            time.sleep(0.05)
        self._look_further()
        ended = time.monotonic()
        status = self._process.poll()
        left, gone_s = self._crowd.wait_gone(
            self._runtime.gone_within_s if status is not None else 0.0
        )
        left_lines = [f"{row.pid} {command(row)[:200]}" for row in left]
        self._crowd.end()
        self._process.wait()
        return AttemptOutcome(
            status=HUNG if status is None else status,
            printed=self._printed.read_text(),
            errors=self._errors.read_text(),
            hits=self._hits,
            ended_s=ended - (self._hits[-1].at if self._hits else self._began),
            gone_s=gone_s,
            left=left_lines,
        )

    def _targets(self) -> dict[str, list[Process]]:
        """Who may be killed now."""
        there = self._crowd.roles()
        now = time.monotonic()
        if any(hit.role == WATCHDOG and now - hit.at < _UNGUARDED_S for hit in self._hits):
            there.pop(LAUNCHER, None)  # the one who would clean up after it is not back yet
        return there

    def _wait(self, condition: Callable[[], bool], pause_s: float = _LOOK_S) -> bool:
        """Waits until a condition holds; False if the command ended before."""
        while not condition():
            if not self._is_running():
                return False
            time.sleep(pause_s)
        return True

    def _is_running(self) -> bool:
        late = time.monotonic() - self._began > self._runtime.patience_s
        return self._process.poll() is None and not late

    def _look_further(self) -> None:
        """Notes when the server had a checkpoint later than any before a kill."""
        for hit in self._hits:
            if hit.further_s is None and self._watched.checkpoint() > hit.window:
                hit.further_s = time.monotonic() - hit.at
