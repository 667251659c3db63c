"""Find and end every process of a session, whatever session or parent it has moved to.

Flower's SuperExec starts a session of its own and Ray's services outlive the process that started
them, so neither a process group nor a tree of parents holds them all. Three things do: an
environment variable that every child inherits (Linux shows it in `/proc`), the session's private
folder, in which they all work (Ray's agents write their titles over the environment that Linux
shows), and the parents seen at each look.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

MARKER = "RISFLEET_SESSION"
_PROC = Path("/proc")
_STARTED = 19  # position of the start time in /proc/PID/stat after the command's name

_SETTLE_S = 0.25
"""A process that has just been started shows no environment for some milliseconds (measured: 21 on
a busy machine): if the one that started it has died, it cannot be found until then."""


@dataclass(frozen=True)
class Process:
    """A process: its number together with its start names it for good."""

    pid: int
    started: str
    parent: int = field(default=0, compare=False)
    zombie: bool = field(default=False, compare=False)


def table() -> dict[int, Process]:
    """All processes of this machine by number."""
    return _table_from_proc() if (_PROC / "self" / "stat").exists() else _table_from_ps()


def identify(pid: int) -> Process | None:
    """The process of that number, None if there is none."""
    return table().get(pid)


def command(process: Process) -> str:
    """Its command line, empty where it is gone or the system does not tell."""
    try:
        return (_PROC / str(process.pid) / "cmdline").read_bytes().replace(b"\0", b" ").decode()
    except (OSError, UnicodeDecodeError):
        return ""


def members(
    marker: str | None, roots: Iterable[Process] = (), folder: Path | None = None
) -> set[Process]:
    """Running processes that carry the marker, work in the folder, are roots, or descend from any.

    Args:
        marker: value of the environment variable `MARKER`; None looks at parents alone (cheap).
        roots: processes known to belong to the session.
        folder: the session's own; None looks at no folder.

    Returns:
        The processes, this one and zombies left out.
    """
    rows = table()
    known = {root.pid for root in roots if rows.get(root.pid) == root}
    if marker is not None:
        unknown = rows.keys() - known
        folder = folder and folder.resolve()
        known |= {pid for pid in unknown if _is_marked(pid, marker) or _works_in(pid, folder)}
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
    """Ask a session's processes to end, and kill those that have not after the grace.

    Args:
        marker: as in `members`.
        roots: as in `members`.
        folder: as in `members`.
        grace_s: seconds from SIGTERM to SIGKILL.
        kill_s: seconds of SIGKILL before giving up.

    Returns:
        The processes that are still there, normally none.
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
            _signal(process, signal.SIGKILL if late else signal.SIGTERM)
        asked |= alive
        time.sleep(0.05)
    return alive


def _signal(process: Process, number: int) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.kill(process.pid, number)


def _is_marked(pid: int, marker: str) -> bool:
    try:
        environment = (_PROC / str(pid) / "environ").read_bytes()
    except OSError:
        return False
    return f"{MARKER}={marker}".encode() in environment.split(b"\0")


def _works_in(pid: int, folder: Path | None) -> bool:
    if folder is None:
        return False
    try:
        return (_PROC / str(pid) / "cwd").readlink() == folder
    except OSError:
        return False


def _table_from_proc() -> dict[int, Process]:
    rows = {}
    for entry in _PROC.iterdir():
        if not entry.name.isdigit():
            continue
        try:
            fields = (entry / "stat").read_text(errors="replace").rpartition(")")[2].split()
        except OSError:
            continue
        pid = int(entry.name)
        rows[pid] = Process(pid, fields[_STARTED], int(fields[1]), fields[0] in "ZX")
    return rows


def _table_from_ps() -> dict[int, Process]:
    listing = subprocess.run(
        ["ps", "-A", "-o", "pid=,ppid=,stat=,lstart="], capture_output=True, text=True, check=True
    )
    rows = {}
    for line in listing.stdout.splitlines():
        pid, parent, state, started = line.split(maxsplit=3)
        rows[int(pid)] = Process(int(pid), started, int(parent), state.startswith("Z"))
    return rows
