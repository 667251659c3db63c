"""Log lines that say which run, round and robots they are about."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

OURS = (
    *("agent", "client_app", "conf", "env", "lockstep"),
    *("repeatable", "server_app", "storage", "training"),
)
"""The loggers of our packages."""


@dataclass
class RunLog:
    """What the lines of a process are about; may change while it lasts.

    Attributes:
        run: the run's identity.
        round: the Flower round, 0 before the first.
        robots: the robots, or rooms, none on the server.
        kind: which of the two.
    """

    run: str | None
    round: int
    robots: Sequence[int]
    kind: str

    def __str__(self) -> str:
        """As it stands at the head of a line."""
        who = f"{self.kind} {','.join(map(str, self.robots))}" if self.robots else "server"
        return f"run {self.run or '-'} round {self.round} {who}"


@contextmanager
def log_lines(
    run: str | None, round_number: int = 0, robots: Sequence[int] = (), kind: str = "robot"
) -> Iterator[RunLog]:
    """Lets our packages log to standard error from the level INFO on, while this lasts.

    Takes what ``RunLog`` holds; yields what each line says of the run.
    """
    about = RunLog(run, round_number, robots, kind)
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s [%(about)s] %(message)s"))

    def add(record: logging.LogRecord) -> bool:
        record.about = str(about)
        return True

    handler.addFilter(add)
    loggers = [logging.getLogger(name) for name in OURS]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
    try:
        yield about
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.removeHandler(handler)
            logger.setLevel(level)
