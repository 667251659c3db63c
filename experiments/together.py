"""Runs that are trained together: their agents learn in one stack, each run stays its own.

Every run keeps its world, streams, strategy, recorder, folder and end; what they share are the
products of gradient steps and of greedy choices. Each ends in the bits that it reaches alone.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from agent import Stack
from conf import Config
from experiments import local
from server_app.session import Share

Ending = dict[str, Any] | Exception
"""What ``summary.json`` holds, or what ended a run before its end."""


def train(runs: Sequence[tuple[Config, Path]]) -> list[Ending]:
    """Trains runs side by side in this process, until the last one has ended.

    Args:
        runs: configurations that differ in nothing but their seeds, and the runs' folders.

    Returns:
        What became of each run, in the same order. One that fails leaves the others to go on.
    """
    robots, aps = Stack(len(runs)), Stack(len(runs))
    members = []
    for index, (config, folder) in enumerate(runs):
        meter = Meter()
        share = Share(len(runs), robots.seat(index), aps.seat(index), meter)
        members.append(_Member(config, folder, share, meter))
    going = list(members)
    try:
        while going:
            for member in going:
                member.take_turn()
            going = [member for member in going if member.ending is None]
            before = time.process_time()
            robots.catch_up()
            aps.catch_up()
            spent_s = time.process_time() - before
            for member in going:
                member.meter.add(spent_s / len(going))
    except BaseException as error:
        for member in members:
            member.give_up(error)
        raise
    return [ending for member in members if (ending := member.ending) is not None]


class Meter:
    """Processor time of one run of several in a process: its own turns, its part of what is shared.

    Called, it says the seconds so far.
    """

    def __init__(self) -> None:
        self._spent_s = 0.0
        self._since: float | None = None

    def __call__(self) -> float:
        """Seconds so far."""
        running = 0.0 if self._since is None else time.process_time() - self._since
        return self._spent_s + running

    def add(self, seconds: float) -> None:
        """Adds a part of what several runs have spent together."""
        self._spent_s += seconds

    @contextmanager
    def running(self) -> Iterator[None]:
        """Counts what the process spends in the meantime."""
        self._since = time.process_time()
        try:
            yield
        finally:
            self._spent_s, self._since = self(), None


class _Member:
    """One of the runs, which goes on from pause to pause.

    Attributes:
        ending: what became of it; None as long as it goes on.
    """

    def __init__(self, config: Config, folder: Path, share: Share, meter: Meter) -> None:
        self._turns = local.turns(config, folder, share)
        self.meter = meter
        self.ending: Ending | None = None

    def take_turn(self) -> None:
        """Goes on to the next pause, or to the end."""
        with self.meter.running():
            try:
                next(self._turns)
            except StopIteration as end:
                self.ending = end.value
            except Exception as error:
                self.ending = error

    def give_up(self, error: BaseException) -> None:
        """Lets the run close what it holds and say why it stopped."""
        with suppress(BaseException):
            self._turns.throw(error)
