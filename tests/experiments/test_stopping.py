"""Ctrl-C and SIGTERM: the first one asks runs to end, the second one ends them."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from rich.console import Console

from experiments.runtimes.stopping import STOPPING, IgnoredSignals, ShieldedSignals, StopSignals

PATIENCE_S = 120.0


@pytest.mark.parametrize("number", STOPPING)
def test_the_first_signal_asks_and_the_second_ends(tmp_path: Path, number: signal.Signals) -> None:
    before = signal.getsignal(number)
    stop, never = tmp_path / "stop", tmp_path / "not begun" / "stop"
    with StopSignals([stop, never], Console(quiet=True)) as signals:
        assert (signals.asked, signals.status) == (False, 0)
        signal.raise_signal(number)
        assert stop.exists()
        assert (signals.asked, signals.status) == (True, 128 + number)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
    assert not stop.exists()
    assert signal.getsignal(number) is before


def test_what_an_earlier_call_has_left_stops_nothing(tmp_path: Path) -> None:
    (tmp_path / "stop").touch()
    with StopSignals([tmp_path / "stop"], Console(quiet=True)):
        assert not (tmp_path / "stop").exists()


def test_ctrl_c_after_sigterm_ends_at_once(tmp_path: Path) -> None:
    with StopSignals([tmp_path / "stop"], Console(quiet=True)) as signals:
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signals.status == 143


@pytest.mark.parametrize("number", STOPPING)
def test_a_shield_takes_signals_by_looking(tmp_path: Path, number: signal.Signals) -> None:
    said = io.StringIO()
    with ShieldedSignals([tmp_path / "stop"], Console(file=said)) as signals:
        os.kill(os.getpid(), number)
        looker = threading.Thread(target=signals.look)
        looker.start()
        looker.join()
        assert signals.number is number
        assert (tmp_path / "stop").exists()
    assert number not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    assert signals.name in said.getvalue()


def test_a_run_that_begins_after_the_signal_is_told_too(tmp_path: Path) -> None:
    late = tmp_path / "late" / "stop"
    with ShieldedSignals([late], Console(quiet=True)) as signals:
        os.kill(os.getpid(), signal.SIGTERM)
        signals.look()
        late.parent.mkdir()
        signals.look()
        assert late.exists()


WORKER = """
import subprocess, sys, time
from experiments.runtimes.stopping import IgnoredSignals
with IgnoredSignals():
    child = subprocess.Popen(["sleep", "60"])
    print(child.pid, flush=True)
    print(child.wait(), flush=True)
    time.sleep(60)
"""


def test_a_worker_passes_over_signals_and_what_it_starts_does_not() -> None:
    root = Path(__file__).parents[2]
    worker = subprocess.Popen(
        [sys.executable, "-c", WORKER],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(root)},
    )
    try:
        assert worker.stdout is not None
        child = int(worker.stdout.readline())
        for number in STOPPING:
            worker.send_signal(number)
        time.sleep(0.2)
        assert worker.poll() is None
        os.kill(child, signal.SIGTERM)
        assert int(worker.stdout.readline()) == -signal.SIGTERM
    finally:
        worker.kill()
        worker.communicate(timeout=PATIENCE_S)


def test_ignored_signals_are_given_back() -> None:
    before = [signal.getsignal(number) for number in STOPPING]
    with IgnoredSignals():
        signal.raise_signal(signal.SIGINT)
    assert [signal.getsignal(number) for number in STOPPING] == before
