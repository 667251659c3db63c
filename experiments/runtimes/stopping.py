"""Ctrl-C, and SIGTERM as batch systems send it: both ask runs to end, and keep what was learned."""

from __future__ import annotations

import _thread
import signal
import threading
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing import resource_tracker
from pathlib import Path
from types import FrameType
from typing import Self

from rich.console import Console

STOPPING = (signal.SIGINT, signal.SIGTERM)
NAMES = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM"}


class StopSignals:
    """A first signal asks runs to end at their next aggregation; a second one ends them at once.

    Python hands signals to its main thread alone: in any other, nothing is taken over. Runs look
    for ``files`` at each aggregation.

    Attributes:
        number: the signal that has asked, None if none has.
    """

    def __init__(self, files: Sequence[Path], console: Console) -> None:
        self._files, self._console = list(files), console
        self.number: signal.Signals | None = None

    @property
    def asked(self) -> bool:
        """Whether a signal has asked."""
        return self.number is not None

    @property
    def status(self) -> int:
        """The exit status that follows: 130 after Ctrl-C, 143 after SIGTERM, 0 without either."""
        return 0 if self.number is None else 128 + self.number

    @property
    def name(self) -> str:
        """What has asked, in words."""
        return "" if self.number is None else NAMES[self.number]

    def __enter__(self) -> Self:
        """Takes the signals over."""
        self._forget()  # what a call that was killed has left
        taken = STOPPING if threading.current_thread() is threading.main_thread() else ()
        self._before = {number: signal.signal(number, self._on_signal) for number in taken}
        return self

    def __exit__(self, *error: object) -> None:
        """Gives the signals back."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._forget()

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.number = signal.Signals(number)
        self._tell()
        self._console.print(f"Stopping at the next aggregation; {self.name} again stops at once.")

    def _tell(self) -> None:
        for file in self._files:
            with suppress(OSError):  # the run has not begun, or its disk takes nothing
                file.touch()

    def _forget(self) -> None:
        for file in self._files:
            file.unlink(missing_ok=True)


def pass_on(status: int) -> None:
    """Raises SIGTERM again where by ``StopSignals.status`` it ended runs: the process ends, too."""
    if status == 128 + signal.SIGTERM:
        signal.raise_signal(signal.SIGTERM)


class ShieldedSignals(StopSignals):
    """The same for runs in processes that a launcher starts.

    The signals are blocked in this thread meanwhile, so that those processes, which inherit that,
    never see one: they would die of it while they import. Another thread must call ``look``.
    """

    def __enter__(self) -> Self:
        """Takes the signals over."""
        resource_tracker.ensure_running()  # as it starts, it unblocks Ctrl-C
        super().__enter__()
        self._mask = signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
        return self

    def __exit__(self, *error: object) -> None:
        """Gives the signals back."""
        self.look()
        signal.pthread_sigmask(signal.SIG_SETMASK, self._mask)
        super().__exit__(*error)

    def look(self) -> None:
        """Takes a signal that waits, and tells runs that have begun since; from another thread."""
        for number in STOPPING:
            if number in signal.sigpending():
                signal.sigwait({number})
                _thread.interrupt_main(number)
        if self.asked:
            self._tell()


class IgnoredSignals:
    """Lets a launcher's worker pass over the signals, and what it starts see them as usual.

    A batch system sends SIGTERM to every process; the one that owns the runs asks them to end.
    """

    def __enter__(self) -> None:
        """Handles the signals, by doing nothing: a handler is not inherited, unlike a mask."""
        self._before = {number: signal.signal(number, lambda *_: None) for number in STOPPING}
        self._mask = signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPPING)

    def __exit__(self, *error: object) -> None:
        """Gives the signals back."""
        signal.pthread_sigmask(signal.SIG_SETMASK, self._mask)
        for number, handler in self._before.items():
            signal.signal(number, handler)
