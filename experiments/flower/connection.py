"""A federation that runs already, by the name of its SuperLink in Flower's configuration."""

from __future__ import annotations

import os
import tomllib
from contextlib import suppress
from pathlib import Path
from typing import Self
from urllib.parse import urlsplit

from env.texts import read_unmarked_text
from experiments.flower import commands
from experiments.flower.control import Status
from experiments.flower.environment import FlowerError, tail, user_environment
from experiments.flower.manifest import Components
from experiments.flower.session import Session
from training.addresses import is_loopback


class Connection:
    """Hands runs to a SuperLink of the user's, and asks after them; nothing there is started."""

    poll_s = 5.0
    """Seconds between questions: each is a command that takes more than a second of CPU."""

    _session: Session

    def __init__(self, name: str) -> None:
        """Takes a connection's name, of the file ``config.toml`` in Flower's home.

        Raises:
            FlowerError: there is no such connection, or it leaves this machine unencrypted.
        """
        _check(name)
        self._name = name
        self._running: int | None = None

    def __enter__(self) -> Self:
        """Makes a place for the files of a run."""
        self._session = Session()
        self._session.environment = user_environment(self._session.marker)
        return self

    def __exit__(self, *error: object) -> None:
        """Stops the run if it has not ended; that it cannot be stopped hides no other error."""
        try:
            if self._running is not None:
                commands.stop_run(self._session, self._running, self._name)
        except FlowerError as unstopped:
            first = error[1]
            if not isinstance(first, BaseException):
                raise
            first.add_note(f"Run {self._running} may be going on: {unstopped}")
        finally:
            self._session.stop()

    def submit(self, overrides: str) -> int:
        """Hands in a run of the app; returns its number.

        Raises:
            FlowerError: Flower refuses.
        """
        self._running = commands.submit_run(
            self._session, overrides, Components(), connection=self._name
        )
        return self._running

    def status(self, run_id: int) -> Status:
        """State of a run.

        Raises:
            UnansweredError: the SuperLink does not answer.
        """
        status = commands.run_status(self._session, run_id, self._name)
        if status.finished:
            self._running = None
        return status

    def log_tail(self, run_id: int, lines: int = 30) -> str:
        """Last lines of what the ServerApp has printed, none where they cannot be had."""
        with suppress(FlowerError):
            return tail(commands.run_log(self._session, run_id, self._name), lines)
        return ""


def flower_home() -> Path:
    """The folder of Flower's configuration of this user."""
    return Path(os.environ.get("FLWR_HOME") or Path.home() / ".flwr")


def _check(name: str) -> None:
    path = flower_home() / "config.toml"
    try:
        known = tomllib.loads(read_unmarked_text(path, "Flower")).get("superlink", {})
    except (OSError, UnicodeError, tomllib.TOMLDecodeError) as error:
        reason = f"{path} cannot be read: {getattr(error, 'strerror', None) or error}"
        raise FlowerError(f"runtime.connection={name}: {reason}.") from error
    connections = {key: value for key, value in known.items() if isinstance(value, dict)}
    if name not in connections:
        there = ", ".join(connections) or "none"
        raise FlowerError(f"runtime.connection={name}: allowed are those of {path}: {there}.")
    address = str(connections[name].get("address", ""))
    host = urlsplit(f"//{address}").hostname or ""
    if connections[name].get("insecure") and not is_loopback(host):
        raise FlowerError(
            f"runtime.connection={name}: {address} is not this machine, and the connection is"
            " insecure: give it root-certificates (risfleet keys makes them)."
        )
