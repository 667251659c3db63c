"""Fixtures of the commands' and the launchers' tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from train_helpers import start

from experiments.cli import main
from experiments.flower import session as sessions
from repeatable import processes
from repeatable.processes import Process

__all__ = ["start"]


@pytest.fixture
def refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., str]:
    """Runs a command that must end with status 2 and leave nothing; returns its one sentence."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: object) -> str:
        before = sorted(tmp_path.rglob("*"))
        capsys.readouterr()
        assert main([*map(str, arguments)]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.startswith("risfleet: ")
        assert said.err.count("\n") == 1, said.err
        assert sorted(tmp_path.rglob("*")) == before
        return said.err

    return run


@pytest.fixture
def session() -> Iterator[sessions.Session]:
    """A session of Flower's processes that is stopped at the end."""
    made = sessions.Session()
    yield made
    made.stop()


class NoGuard:
    """In the place of a session's watchdog, whose process takes longer than most tests."""

    def __init__(self, marker: str, folder: Path) -> None: ...

    def add(self, root: Process) -> None:
        """Would tell it of a process."""

    def keep(self) -> None:
        """Would start it again."""

    def stop(self) -> None:
        """Would end it."""


@pytest.fixture
def unguarded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sessions have no watchdog, which ``test_guard.py`` looks at."""
    monkeypatch.setattr(sessions, "Guard", NoGuard)


@pytest.fixture
def swift(unguarded: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their ends wait for no process that shows its marker late, either."""
    monkeypatch.setattr(processes, "_SETTLE_S", 0.02)
