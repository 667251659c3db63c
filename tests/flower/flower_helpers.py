"""Whole runs by the command, as processes that are watched."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from experiments.cli import main
from experiments.flower.control import is_healthy
from experiments.flower.environment import HOST, flower_command, free_port
from experiments.flower.manifest import write_connection
from experiments.flower.session import Session
from repeatable.processes import MARKER, Process, identify, members, terminate

PATIENCE_S = 300.0


class OwnFederation:
    """A SuperLink, and SuperNodes each with a ``state-dir``, as people start them themselves.

    Args:
        place: where the folders of the SuperNodes lie.
        log: where all of them write.
    """

    def __init__(self, place: Path, log: IO[bytes]) -> None:
        self._place, self._log = place, log
        self.session, self._port = Session(), free_port()
        self.session.spawn(
            [flower_command("flower-superlink"), "--insecure", "--isolation", "subprocess",
             "--disable-runtime-dependency-installation", "--host", HOST,
             "--port", str(self._port)],
            log,
        )  # fmt: skip
        wait_until(lambda: is_healthy(self._port))
        write_connection(self.session.folder, f"{HOST}:{self._port}", None)

    def state_dir(self, number: int) -> Path:
        """Where a SuperNode keeps its robots' state."""
        return self._place / f"node-{number}"

    def join(self, number: int) -> subprocess.Popen[bytes]:
        """Starts a SuperNode, or starts it again."""
        own = f'partition-id={number} num-partitions=2 state-dir="{self.state_dir(number)}"'
        return self.session.spawn(
            [flower_command("flower-supernode"), "--insecure", "--superlink",
             f"{HOST}:{self._port}", "--port", str(free_port()), "--node-config", own],
            self._log,
        )  # fmt: skip


@contextmanager
def own_federation(place: Path) -> Iterator[OwnFederation]:
    """A federation that is ended afterwards, with a look whether anything is left."""
    with (place / "federation.log").open("wb") as log:
        federation = OwnFederation(place, log)
        try:
            yield federation
        finally:
            federation.session.stop()
    assert members(federation.session.marker) == set()


def summary(folder: Path) -> dict[str, Any]:
    """What a run came to."""
    content: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return content


def with_changes(overrides: Sequence[str], *changes: str) -> list[str]:
    """Overrides with others put in the place of those of the same key."""
    keys = {change.split("=")[0] for change in changes}
    return [item for item in overrides if item.split("=")[0] not in keys] + list(changes)


def digests_in_one_process(overrides: Sequence[str], folder: Path, *changes: str) -> dict[str, str]:
    """The digests of a run of the command, to which nothing happens."""
    given = with_changes(overrides, *changes, f"run.dir={folder}")
    assert main(["train", *given]) == 0
    found: dict[str, str] = summary(folder)["digest"]
    return found


def wait_until(condition: Callable[[], bool], process: subprocess.Popen[str] | None = None) -> None:
    """Waits for a condition; fails where a process that is to bring it about has ended."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.2)


def start(overrides: Sequence[str], place: Path) -> subprocess.Popen[str]:
    """The command as a process of its own, which writes to pipes."""
    return subprocess.Popen(
        [sys.executable, "-m", "experiments.cli", "train", *overrides],
        cwd=place,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


@contextmanager
def commands(place: Path) -> Iterator[Callable[[Sequence[str]], subprocess.Popen[str]]]:
    """``start``, whose processes are killed in the end."""
    started: list[subprocess.Popen[str]] = []

    def make(overrides: Sequence[str]) -> subprocess.Popen[str]:
        started.append(start(overrides, place))
        return started[-1]

    try:
        yield make
    finally:
        for process in started:
            process.kill()
            process.communicate()


def state_of(folder: Path) -> str:
    """What a run says of itself; empty before it has begun."""
    try:
        return str(json.loads((folder / "progress.json").read_text())["state"])
    except (OSError, ValueError):
        return ""


def marker_below(process: subprocess.Popen[str]) -> str:
    """The marker of the session that a command has started."""
    top = identify(process.pid)
    assert top is not None
    for row in members(None, [top]):
        found = variable(row, MARKER)
        if found:
            return found
    return ""


@contextmanager
def watched(process: subprocess.Popen[str]) -> Iterator[Callable[[], str]]:
    """Tells the marker of the session that a command has started; both are ended in the end."""
    markers: list[str] = []

    def marker() -> str:
        markers.append(marker_below(process))
        assert markers[-1]
        return markers[-1]

    try:
        yield marker
    finally:
        for each in markers:
            terminate(each)
        process.kill()
        process.communicate()


def variable(process: Process, name: str) -> str:
    """A variable of a process's environment, empty where it has none."""
    try:
        text = Path(f"/proc/{process.pid}/environ").read_bytes().decode(errors="replace")
    except OSError:
        return ""
    pairs = dict(item.partition("=")[::2] for item in text.split("\0"))
    return pairs.get(name, "")
