"""A private SuperLink on this machine: what the runtimes that start one have in common."""

from __future__ import annotations

import re
import time
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Self

from experiments.flower import commands, control
from experiments.flower.control import ControlError, RunState, Status
from experiments.flower.environment import (
    HOST,
    FlowerError,
    ProcessLostError,
    flower_command,
    free_port,
    tail,
)
from experiments.flower.executor import Executor
from experiments.flower.manifest import Components, write_connection
from experiments.flower.session import Session
from repeatable.processes import Process, members

if TYPE_CHECKING:
    import subprocess

_PORT_ATTEMPTS = 3
_ANSI = re.compile(r"\x1b\[[0-9;]*m")


class SuperLink:
    """Starts a SuperLink on entry; on exit nothing of it and of what it has started is left.

    Processes of the app inherit our environment; their working folder is a private one that is
    removed at the end, so every path that they are given must be absolute.
    """

    poll_s = 1.0
    """Seconds between questions after a run."""

    simulated: int | None = None
    """Nodes that Flower's simulation engine is to run; None where SuperNodes join."""

    def __init__(self, *, log_path: Path, start_timeout_s: float = 120.0) -> None:
        """Prepares; nothing is started yet.

        Args:
            log_path: file that gets the SuperLink's output and, at the end, the runs' own.
            start_timeout_s: seconds for the SuperLink to answer, and again for a run to start.
        """
        self._log_path = log_path
        self._start_timeout_s = start_timeout_s
        self._port = 0
        self._authority: Path | None = None
        self._session: Session | None = None
        self._superlink: subprocess.Popen[bytes] | None = None
        self._executor: Executor | None = None
        self._log: IO[bytes] | None = None
        self._log_begin = 0
        self._submitted: dict[int, float] = {}

    def __enter__(self) -> Self:
        """Starts the SuperLink and waits until it answers.

        Raises:
            FlowerError: it does not, and why.
        """
        try:
            self._session = Session()
            self._log_path.parent.mkdir(parents=True, exist_ok=True)
            self._log = self._log_path.open("ab")
            for attempt in range(1, _PORT_ATTEMPTS + 1):
                if self._start(last=attempt == _PORT_ATTEMPTS):
                    break
            self._on_start()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        """Stops everything."""
        self.stop()

    def submit(self, overrides: str, components: Components | None = None) -> int:
        """Hands in a run of the app, by default this project's; returns its number.

        Raises:
            FlowerError: Flower refuses.
        """
        session = self._require_alive()
        run_id = commands.submit_run(
            session, overrides, components or Components(), simulated=self.simulated
        )
        self._submitted[run_id] = time.monotonic()
        return run_id

    def status(self, run_id: int) -> Status:
        """State of a run; FAILED also where what runs it died and Flower has not noticed.

        A few milliseconds, to be asked about once a second.

        Raises:
            UnansweredError: the SuperLink is there and does not answer.
            FlowerError: it ended, or the run did not start in time.
        """
        self._require_alive().keep_guard()
        status = self._ask(run_id)
        if not status.finished and (death := self._loss(status)):
            status = self._ask(run_id)  # it may have ended well in between
            if not status.finished:
                return Status(RunState.FAILED, death)
        self._require_progress(run_id, status)
        return status

    def log_tail(self, run_id: int) -> str:
        """Last lines, without colours, that the run's apps printed, else of the SuperLink's log."""
        text = ""
        with suppress(ControlError):
            text = control.run_log(self._port, run_id, self._authority)
        return tail(_ANSI.sub("", text)) or self._superlink_log()

    def stop(self) -> None:
        """Ends every process and removes the private folder; may be called again."""
        session, self._session = self._session, None
        if session is None:
            return
        try:
            self._save_run_logs()
        finally:
            session.stop()
            if self._log is not None:
                with suppress(OSError):  # of a full disk: a log is no reason for a run to fail
                    self._log.close()

    # --- What differs between runtimes ------------------------------------------------------------

    def _options(self, session: Session) -> list[str]:
        """Of the SuperLink's command, where it listens left out."""
        raise NotImplementedError

    def _on_start(self) -> None:
        """The SuperLink answers."""

    def _loss(self, status: Status) -> str:
        """What keeps a run from ever ending, whether it runs already or not."""
        assert self._executor is not None
        if self._executor.has_died(members(None, [self._root()])):
            return "Flower's SuperExec ended without a word"
        return self._death() if status.state is RunState.RUNNING else ""

    def _death(self) -> str:
        """What keeps a run that is running from ever ending, in words; empty while all is well."""
        return ""

    # --- The SuperLink's process ------------------------------------------------------------------

    def _start(self, *, last: bool) -> bool:
        """Starts the SuperLink; False where its port was taken in the meantime."""
        assert self._session is not None
        assert self._log is not None
        self._port = free_port()
        options = self._options(self._session)
        write_connection(self._session.folder, f"{HOST}:{self._port}", self._authority)
        self._log_begin = self._log.seek(0, 2)
        self._superlink = self._session.spawn(
            [flower_command("flower-superlink"), *options,
             "--isolation", "subprocess", "--disable-runtime-dependency-installation",
             "--host", HOST, "--port", str(self._port)],
            self._log,
        )  # fmt: skip
        self._executor = Executor(self._session.root(self._superlink))
        deadline = time.monotonic() + self._start_timeout_s
        while not control.is_healthy(self._port, self._authority):
            self._session.keep_guard()
            if self._superlink.poll() is not None:
                if not last and "address already in use" in self._superlink_log():
                    return False
                self._require_alive()
            if time.monotonic() > deadline:
                seconds = f"{self._start_timeout_s:.0f} s"
                message = f"Flower's SuperLink did not answer within {seconds}."
                raise FlowerError(message, self._superlink_log())
            time.sleep(0.1)
        self._require_alive()
        return True

    def _root(self) -> Process:
        """The SuperLink's process."""
        session = self._require_alive()
        assert self._superlink is not None
        return session.root(self._superlink)

    def _require_alive(self) -> Session:
        if self._session is None or self._superlink is None:
            raise FlowerError("Flower's SuperLink is not running.")
        if (code := self._superlink.poll()) is not None:
            message = f"Flower's SuperLink ended with status {code}."
            raise ProcessLostError(message, self._superlink_log())
        return self._session

    def _waited_s(self, run_id: int) -> float:
        return time.monotonic() - self._submitted.get(run_id, time.monotonic())

    def _require_progress(self, run_id: int, status: Status) -> None:
        pending = not status.finished and status.state is not RunState.RUNNING
        if pending and self._waited_s(run_id) > self._start_timeout_s:
            seconds = f"{self._start_timeout_s:.0f} s"
            message = f"The run is still {status.state} {seconds} after it was handed to Flower."
            raise FlowerError(message, self._superlink_log())

    def _ask(self, run_id: int) -> Status:
        session = self._require_alive()
        try:
            return control.run_status(self._port, run_id, self._authority)
        except ControlError:
            try:
                return commands.run_status(session, run_id)
            except FlowerError:
                self._require_alive()  # it may have died just now
                raise

    def _superlink_log(self) -> str:
        with suppress(OSError), self._log_path.open("rb") as log:
            log.seek(self._log_begin)
            return tail(_ANSI.sub("", log.read().decode(errors="replace")))
        return ""

    def _save_run_logs(self) -> None:
        """Appends what the runs printed, which only the SuperLink's memory holds."""
        if self._log is None or self._superlink is None or self._superlink.poll() is not None:
            return
        for run_id in self._submitted:
            with suppress(ControlError, OSError):
                text = _ANSI.sub("", control.run_log(self._port, run_id, self._authority))
                self._log.write(f"\n--- Run {run_id} ---\n{text}".encode())
