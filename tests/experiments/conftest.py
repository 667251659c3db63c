"""Fixtures of the commands' and the launchers' tests."""

from __future__ import annotations

from pathlib import Path

import pytest
from train_helpers import start

from experiments.flower import session
from repeatable import processes
from repeatable.processes import Process

__all__ = ["start"]


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
    monkeypatch.setattr(session, "Guard", NoGuard)


@pytest.fixture
def swift(unguarded: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their ends wait for no process that shows its marker late, either."""
    monkeypatch.setattr(processes, "_SETTLE_S", 0.02)
