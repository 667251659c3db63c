"""What the system refuses is said in a sentence, and output that nobody takes ends nothing."""

from __future__ import annotations

import errno
import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import pytest
import train_helpers
from rich.console import Console

from conf import ConfigError
from experiments.batch import watch
from experiments.cli import main
from experiments.console import display
from experiments.console.mishaps import in_words
from experiments.console.steady import Steady, steady_output
from experiments.flower import environment
from experiments.runtimes import runner
from training.run_folder import RunFolder

ROOT = Path(__file__).parents[2]
PATIENCE_S = 300.0
SMALL = (*train_helpers.SMALL, "run.dir=run")


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


# --- Words ----------------------------------------------------------------------------------------


def test_the_reason_stands_before_the_files() -> None:
    full = OSError(errno.ENOSPC, "No space left on device", "/runs/a")
    assert in_words(full) == "No space left on device: /runs/a"
    moved = FileNotFoundError(errno.ENOENT, "No such file", b"a", None, Path("b"))
    assert in_words(moved) == "No such file: a -> b"


def test_without_a_file_the_place_in_the_code_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(environment.socket, "socket", refuse)  # type: ignore[attr-defined]
    with pytest.raises(OSError, match="Too many") as refused:
        environment.free_port()
    place = "in free_port of experiments/flower/environment.py, line "
    assert in_words(refused.value).startswith(
        f"Too many open files (allow more with `ulimit -n`), {place}"
    )


@pytest.mark.parametrize(
    "error",
    [
        BrokenPipeError(errno.EPIPE, "Broken pipe"),
        OSError(errno.EMFILE, "Too many open files"),
        socket.gaierror(-2, "Name or service not known"),
        ConnectionResetError(errno.ECONNRESET, "Connection reset by peer"),
        OSError(errno.EIO, None),
        OSError("a sentence of its own"),
        TimeoutError(),
    ],
    ids=str,
)
@pytest.mark.parametrize("through", ["a run", "a command"])
def test_no_error_of_the_system_is_said_by_its_number(
    error: OSError,
    through: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(*_: Any) -> None:
        raise error

    if through == "a run":
        monkeypatch.setitem(runner.RUNTIMES, "local", fail)
        assert main(["train", *SMALL]) == 1
    else:
        monkeypatch.setattr(RunFolder, "read_progress", fail)
        assert main(["status", "run"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("risfleet: ")
    assert said.count("\n") == 1
    assert "[Errno" not in said
    assert len(said) > len("risfleet: x\n")


def test_what_has_a_text_of_its_own_keeps_it() -> None:
    assert in_words(ConfigError("run.dir=x: allowed is y")) == "run.dir=x: allowed is y"


# --- Output ---------------------------------------------------------------------------------------


@pytest.fixture(params=["nobody reads", "a full disk"])
def lost(request: pytest.FixtureRequest) -> Iterator[IO[str]]:
    """A stream to which nothing can be written."""
    if request.param == "nobody reads":
        reading, writing = os.pipe()
        os.close(reading)
        stream = os.fdopen(writing, "w")
    elif Path("/dev/full").exists():
        stream = os.fdopen(os.open("/dev/full", os.O_WRONLY), "w")
    else:
        pytest.skip("needs /dev/full")
    yield stream
    stream.close()


def test_a_run_whose_output_nobody_takes_goes_on_to_its_end(
    lost: IO[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdout", lost)
    assert main(["train", *SMALL]) == 0
    assert json.loads(Path("run/summary.json").read_text())["ticks"] == 20
    assert json.loads(Path("run/progress.json").read_text())["state"] == "done"
    assert capsys.readouterr().err == ""


def test_an_error_that_nobody_reads_is_no_traceback(
    lost: IO[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", lost)
    assert main(["train", "env.robots=0"]) == 2


@pytest.mark.parametrize(
    "arguments", [("--help",), pytest.param(("train", "--cfg"), marks=pytest.mark.slow)]
)
def test_a_command_whose_output_nobody_takes_ends_well_and_silently(
    arguments: tuple[str, ...],
) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    path = {**os.environ, "PYTHONPATH": str(ROOT)}
    ended = subprocess.run(
        [sys.executable, "-m", "experiments.cli", *arguments],
        stdout=writing,
        stderr=subprocess.PIPE,
        env=path,
        timeout=PATIENCE_S,
    )
    os.close(writing)
    assert (ended.returncode, ended.stderr) == (0, b"")


def test_what_can_be_written_is_written_and_the_streams_come_back(
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = sys.stdout, sys.stderr
    with steady_output():
        assert isinstance(sys.stdout, Steady)
        print("out")
        print("err", file=sys.stderr)
        Console().print("rich")
    assert capsys.readouterr() == ("out\nrich\n", "err\n")
    assert (sys.stdout, sys.stderr) == before


def test_without_any_output_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    assert main(["--version"]) == 0


# --- Who only watches -----------------------------------------------------------------------------


def test_a_display_that_fails_says_so_once_and_the_run_goes_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(RunFolder, "read_progress", lambda self: {"state": 3, "episode": None})
    monkeypatch.setattr(display, "POLL_S", 0.01)
    assert main(["train", *SMALL]) == 0
    said = capsys.readouterr().err
    assert said.startswith("risfleet: no progress is shown from here on (KeyError: ")
    assert said.count("\n") == 1


def test_a_display_that_cannot_start_is_left_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(self: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    with display.Display(RunFolder(Path("run")), Console()):
        pass
    assert "no progress is shown" in capsys.readouterr().err


def test_ctrl_c_is_still_taken_where_the_watch_has_failed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    looks = threading.Event()

    class Interrupts:
        def look(self) -> None:
            looks.set()

    def broken(self: watch.Watch) -> None:
        raise ValueError("odd")

    monkeypatch.setattr(watch.Watch, "_draw", broken)
    monkeypatch.setattr(watch, "POLL_S", 0.01)
    with watch.Watch(0, [], Interrupts(), Console()):
        assert looks.wait(PATIENCE_S)
    assert "ValueError: odd" in capsys.readouterr().err
