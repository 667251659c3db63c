"""A session's watchdog: it is there again when it died, and nothing that befalls it ends a run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from process_helpers import wait_until

from experiments.flower import control, guard, superlink
from experiments.flower.control import RunState, Status
from experiments.flower.engine import SimulationSuperLink
from experiments.flower.guard import Guard
from experiments.flower.session import Session
from repeatable.processes import MARKER, identify

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")

SLEEPER = [sys.executable, "-c", "import time; time.sleep(600)"]
PATIENCE_S = 300.0


def kill(watched: Guard) -> int:
    """Kills a watchdog and waits until nobody reads its pipe; returns its number."""
    process = watched._process
    assert process is not None
    os.kill(process.pid, signal.SIGKILL)
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
    return process.pid


def test_a_session_whose_watchdog_died_starts_processes_and_stops(session: Session) -> None:
    for _ in range(3):
        kill(session._guard)
        child = session.spawn(SLEEPER, subprocess.DEVNULL)
        assert child.poll() is None
    kill(session._guard)
    session.stop()
    assert child.poll() is not None
    assert not session.folder.exists()


def test_a_pipe_that_breaks_between_a_look_and_a_line_is_no_error(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Guard, "keep", lambda self: False)
    kill(session._guard)
    session.spawn(SLEEPER, subprocess.DEVNULL)
    session.stop()


def test_a_watchdog_that_died_is_started_again_and_knows_all(tmp_path: Path) -> None:
    owner = f"""
import os, signal, subprocess, sys, time
from experiments.flower.session import Session
session = Session()
bare = [sys.executable, "-c", "import os, sys; os.chdir('/'); "
        "os.execve(sys.executable, ['p', '-c', 'import time; time.sleep(600)'], {{}})"]
child = session.spawn(bare, subprocess.DEVNULL)
with open({str(tmp_path / "pid")!r}, "w") as file:
    file.write(str(child.pid))
os.kill(session._guard._process.pid, signal.SIGKILL)
os.waitid(os.P_PID, session._guard._process.pid, os.WEXITED | os.WNOWAIT)
session.keep_guard()
time.sleep(1)
os._exit(1)
"""
    path = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    subprocess.run([sys.executable, "-c", owner], env=path, check=False, timeout=PATIENCE_S)
    pid = int((tmp_path / "pid").read_text())
    wait_until(lambda: (row := identify(pid)) is None or row.zombie)


def test_a_launcher_looks_after_its_watchdog_whenever_it_asks_for_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(superlink, "flower_command", lambda name: str(tmp_path / "sleep"))
    monkeypatch.setattr(control, "is_healthy", lambda *_: True)
    monkeypatch.setattr(control, "run_status", lambda *_: Status(RunState.COMPLETED))
    (tmp_path / "sleep").write_text(f"#!{sys.executable}\nimport time; time.sleep(600)")
    (tmp_path / "sleep").chmod(0o755)
    with SimulationSuperLink(log_path=tmp_path / "log") as running:
        assert running._session is not None
        watched = running._session._guard
        first = kill(watched)
        assert running.status(1).finished
        assert watched._process is not None
        assert watched._process.pid != first
        assert watched._process.poll() is None


def test_a_watchdog_that_cannot_live_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = []

    def refuse(*_: Any, **__: Any) -> None:
        started.append(1)
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(guard.subprocess, "Popen", refuse)  # type: ignore[attr-defined]
    watched = Guard("name", tmp_path)
    for _ in range(50):
        watched.keep()
    watched.stop()
    assert len(started) == guard._MOST_STARTS


def test_a_watchdog_that_stands_still_holds_up_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guard, "_LAST_S", 0.1)
    watched = Guard("name", tmp_path / "none")
    assert watched._process is not None
    os.kill(watched._process.pid, signal.SIGSTOP)
    row = identify(os.getpid())
    assert row is not None
    for _ in range(10_000):  # more than a pipe holds
        watched._tell([row])
    watched.stop()
    assert watched._process.returncode == -signal.SIGKILL


def test_a_watchdog_sees_what_is_chosen_and_no_marker(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in (MARKER, "all_proxy", "PYTHONINSPECT", "PYTHONUTF8"):
        monkeypatch.setenv(name, "1")
    watched = Guard("name", tmp_path / "none")
    assert watched._process is not None
    content = Path(f"/proc/{watched._process.pid}/environ").read_bytes().decode()
    watched.stop()
    names = {line.partition("=")[0] for line in content.split("\0")}
    assert not {MARKER, "all_proxy", "PYTHONINSPECT"} & names
    assert "PYTHONUTF8" in names


def test_a_watchdog_takes_neither_the_time_nor_the_memory_of_torch() -> None:
    script = "import experiments.flower.watchdog, sys; print('torch' in sys.modules)"
    path = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    told = subprocess.run([sys.executable, "-c", script], env=path, capture_output=True, text=True)
    assert told.stdout == "False\n", told.stderr
