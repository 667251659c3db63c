"""Start, find and end every process of a session, whatever session or parent it has moved to.

Flower's SuperExec starts a session of its own and Ray's services outlive the process that started
them, so neither a process group nor a tree of parents holds them all. Three things do: an
environment variable that every child inherits (the system shows it), the session's private
folder, in which they all work (Ray's agents write their titles over the environment that Linux
shows), and the parents seen at each look.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sysconfig
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import psutil  # type: ignore[import-untyped]

SETTINGS = {
    "FLWR_TELEMETRY_ENABLED": "0",
    "FLWR_DISABLE_UPDATE_CHECK": "1",
    # Without it a SuperLink installs the dependencies anew for every run, torch included.
    "FLWR_DISABLE_RUNTIME_DEPENDENCY_INSTALLATION": "1",
    "RAY_USAGE_STATS_ENABLED": "0",
}
"""Variables for processes of a private Flower session."""

MARKER = "RISFLEET_SESSION"

_SETTLE_S = 0.25
"""A process that has just been started shows no environment for some milliseconds (measured: 21 on
a busy machine): if the one that started it has died, it cannot be found until then."""


@dataclass(frozen=True)
class Process:
    """A process: its number together with its start names it for good.

    Attributes:
        pid: its number.
        started: seconds from the machine's start to its own, as text.
        parent: the number of the process that started it.
        zombie: whether it has ended, and its parent has not looked yet.
    """

    pid: int
    started: str
    parent: int = field(default=0, compare=False)
    zombie: bool = field(default=False, compare=False)


def with_scripts(environment: Mapping[str, str]) -> dict[str, str]:
    """An environment in which Flower finds its own commands, which it starts by bare names."""
    scripts = sysconfig.get_path("scripts")
    path = os.pathsep.join([scripts, environment.get("PATH", os.defpath)])
    return {**environment, "PATH": path}


def started_apart(
    argv: Sequence[str],
    folder: Path,
    environment: Mapping[str, str],
    output: IO[bytes] | int,
    errors: IO[bytes] | int = subprocess.STDOUT,
) -> subprocess.Popen[bytes]:
    """Starts a process in a folder, away from our terminal's signals; errors go with the output."""
    return subprocess.Popen(
        argv,
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=errors,
        cwd=folder,
        env=environment,
        start_new_session=True,
    )


def table() -> dict[int, Process]:
    """All processes of this machine by number."""
    psutil.process_iter.cache_clear()  # else a number that another process has now keeps its start
    booted_s = psutil.boot_time()
    rows = (_row(handle, booted_s) for handle in psutil.process_iter())
    return {row.pid: row for row in rows if row is not None}


def identify(pid: int) -> Process | None:
    """The process of that number, None if there is none."""
    try:
        return _row(psutil.Process(pid), psutil.boot_time())
    except psutil.Error:
        return None


def command(process: Process) -> str:
    """Its command line, empty where it is gone or the system does not tell."""
    try:
        return " ".join(psutil.Process(process.pid).cmdline())
    except psutil.Error:
        return ""


def environment(pid: int) -> Mapping[str, str]:
    """The environment that a process began with, empty where the system does not tell."""
    try:
        found: dict[str, str] = psutil.Process(pid).environ()
        return found
    except psutil.Error:
        return {}


def members(
    marker: str | None,
    roots: Iterable[Process] = (),
    folder: Path | None = None,
    *,
    variable: str = MARKER,
) -> set[Process]:
    """Running processes that carry the marker, work in the folder, are roots, or descend from any.

    Args:
        marker: value of the environment variable; None looks at parents alone (cheap).
        roots: processes known to belong to the session.
        folder: the session's own; None looks at no folder.
        variable: the environment variable.

    Returns:
        The processes, this one and zombies left out.
    """
    rows = table()
    known = {root.pid for root in roots if rows.get(root.pid) == root}
    if marker is not None:
        folder = folder and folder.resolve()
        for pid in rows.keys() - known:
            if environment(pid).get(variable) == marker or (folder and _works_in(pid, folder)):
                known.add(pid)
    children: dict[int, list[int]] = {}
    for row in rows.values():
        children.setdefault(row.parent, []).append(row.pid)
    found: set[int] = set()
    pending = list(known)
    while pending:
        pid = pending.pop()
        if pid not in found and pid != os.getpid():
            found.add(pid)
            pending += children.get(pid, [])
    return {rows[pid] for pid in found if not rows[pid].zombie}


def terminate(
    marker: str | None,
    roots: Iterable[Process] = (),
    folder: Path | None = None,
    *,
    grace_s: float = 3.0,
    kill_s: float = 5.0,
) -> set[Process]:
    """Ask a session's processes, see `members`, to end; SIGKILL follows `grace_s` seconds later.

    Returns:
        The processes that are still there another `kill_s` seconds later, normally none.
    """
    known = set(roots)
    asked: set[Process] = set()
    begin = seen = time.monotonic()
    while (alive := members(marker, known, folder)) or time.monotonic() - seen < _SETTLE_S:
        elapsed = time.monotonic() - begin
        if elapsed > grace_s + kill_s:
            break
        seen = time.monotonic() if alive else seen
        known |= alive
        late = elapsed > grace_s
        for process in alive if late else alive - asked:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(process.pid, signal.SIGKILL if late else signal.SIGTERM)
        asked |= alive
        time.sleep(0.05)
    return alive


def _row(handle: psutil.Process, booted_s: float) -> Process | None:
    """What is known of a process; None where it has gone.

    Its start counts from the machine's, so that it stays the same where the clock is set.
    """
    try:
        with handle.oneshot():
            started_s = handle.create_time() - booted_s
            is_zombie = handle.status() in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD)
            return Process(handle.pid, f"{started_s:.2f}", handle.ppid(), is_zombie)
    except psutil.Error:
        return None


def _works_in(pid: int, folder: Path) -> bool:
    try:
        return bool(psutil.Process(pid).cwd() == str(folder))
    except psutil.Error:
        return False
