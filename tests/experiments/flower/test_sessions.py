"""Sessions of processes: what they start ends with them, however well it hides."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from experiments.flower.session import Session
from repeatable.processes import MARKER, Process, identify, members

PATIENCE_S = 120.0

ORPHAN = """
import os, subprocess, sys
kept = {name: value for name, value in os.environ.items() if name not in sys.argv[2:]}
sleeper = [sys.executable, "-c", "import time; time.sleep(600)"]
quiet = {name: subprocess.DEVNULL for name in ("stdin", "stdout", "stderr")}
child = subprocess.Popen(sleeper, env=kept, start_new_session=True, **quiet)
with open(sys.argv[1], "w") as file:
    file.write(str(child.pid))
"""
"""Leaves a process behind that has neither its parent nor the variables named."""

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="reads /proc"),
    pytest.mark.usefixtures("unguarded"),
]


def orphan(session: Session, said: Path, *lost: str) -> Process:
    """A process that a process of the session left behind without some of its variables."""
    session.run([sys.executable, "-c", ORPHAN, str(said), *lost], PATIENCE_S)
    found = identify(int(said.read_text()))
    assert found is not None
    return found


def has_ended(process: Process) -> bool:
    """Whether it is gone, or is only to be cleared away by who has inherited it."""
    now = identify(process.pid)
    return now != process or now.zombie


@pytest.mark.parametrize("lost", [(), (MARKER,)], ids=["marked", "in the folder alone"])
def test_an_orphan_ends_with_its_session(
    lost: tuple[str, ...], session: Session, tmp_path: Path
) -> None:
    left = orphan(session, tmp_path / "pid", *lost)
    assert left in members(session.marker, (), session.folder)
    session.stop()
    assert has_ended(left)
    assert not session.folder.exists()


def test_who_works_elsewhere_and_is_not_marked_is_left_alone(
    session: Session, tmp_path: Path
) -> None:
    sleeper = [sys.executable, "-c", "import time; time.sleep(600)"]
    with subprocess.Popen(sleeper, cwd=tmp_path) as other:
        try:
            session.stop()
            assert other.poll() is None
        finally:
            other.kill()


def test_the_watchdog_ends_an_orphan_once_the_owner_is_gone(tmp_path: Path) -> None:
    owner = f"""
import os
from pathlib import Path
from experiments.flower.session import Session
session = Session()
session.run([{sys.executable!r}, "-c", {ORPHAN!r}, {str(tmp_path / "pid")!r}, {MARKER!r}], 30.0)
os._exit(1)
"""
    path = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    subprocess.run([sys.executable, "-c", owner], env=path, check=False, timeout=PATIENCE_S)
    pid = int((tmp_path / "pid").read_text())
    until = time.monotonic() + PATIENCE_S
    while (row := identify(pid)) is not None and not row.zombie and time.monotonic() < until:
        time.sleep(0.1)
    assert row is None or row.zombie
