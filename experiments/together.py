"""Runs that are trained together: their agents learn in one stack, each run stays its own.

Every run keeps its world, streams, strategy, recorder, folder and end; what they share are the
products of gradient steps and of greedy choices. Each ends in the bits that it reaches alone.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from agent import Stack, goes_together
from conf import Config, ConfigError, robots_learn
from experiments import local
from experiments.folders import alone, clear, placed
from server_app import resume
from server_app.checkpoint import Checkpoint
from server_app.files import finite
from server_app.session import Share

Ending = dict[str, Any] | Exception
"""What ``summary.json`` holds, or what ended a run before its end."""


def train(
    configs: Sequence[Config], folders: Sequence[Path], *, missing: bool = False
) -> list[Ending]:
    """Trains runs side by side in this process, until the last one has ended.

    Each of them leaves in its folder what ``risfleet train`` would have left. Where there is no
    stack to share (see ``can_share``), runs follow one another. A file named ``stop`` in a run's
    folder ends that run at its next aggregation. Nothing is printed.

    Args:
        configs: checked configurations with ``runtime=local`` whose agents are alike: those of
            several seeds, or of values that leave networks, learning and K as they are.
        folders: the runs', as many. New or empty ones, without ``missing``.
        missing: whether to do what is still missing: a run that has ended is not touched, one that
            was stopped or died goes on from its newest whole checkpoint, and one that has none
            begins, again if need be. Either way it ends in the bits of a run without a break.

    Returns:
        What became of each run, in the same order. One that fails leaves the others to go on; a
        folder that another process holds or that holds another run is such a failure, too.
    """
    endings: list[Ending | None] = [None] * len(configs)
    going: list[_Member] = []
    with ExitStack() as held:
        for index, run in enumerate(zip(configs, folders, strict=True)):
            try:
                check_local(run[0])
                config, folder = placed(*run)
                held.enter_context(alone(folder))
                resumed = None
                if missing:
                    config, resumed = _resumed(config, folder)
            except Exception as error:
                endings[index] = error
            else:
                if isinstance(resumed, dict):
                    endings[index] = resumed
                else:
                    going.append(_Member(index, config, folder, resumed))
        _side_by_side([member for member in going if can_share(member.config)])
        for member in going:
            if not can_share(member.config):
                _side_by_side([member])
    for member in going:
        endings[member.index] = member.ending
    return [ending for ending in endings if ending is not None]


def check_local(config: Config) -> None:
    """Checks that a run takes place in one process.

    Raises:
        ConfigError: it does not.
    """
    if config.runtime.name != "local":
        allowed = "local for runs together, which share one process"
        raise ConfigError.of([("runtime", config.runtime.name, allowed)])


def can_share(config: Config) -> bool:
    """Whether runs of a configuration have agents for a stack.

    Those are robots that learn for themselves, in ways that ``agent.goes_together`` allows.
    """
    return robots_learn(config) and goes_together(config.agent)


def _resumed(config: Config, folder: Path) -> tuple[Config, dict[str, Any] | Checkpoint | None]:
    """What a run has come to, or where it goes on, its folder made ready for that.

    Returns:
        The configuration, with the identity that the run has had so far, and what
        ``resume.standing`` says.

    Raises:
        ConfigError: see ``resume.standing``.
    """
    found = resume.standing(config, folder)
    if not isinstance(found, dict):
        clear(folder, whole=found is None)
    if isinstance(found, Checkpoint):
        identity = found.meta.get("run")
        config = dataclasses.replace(config, run=dataclasses.replace(config.run, id=identity))
    return config, found


def _side_by_side(members: Sequence[_Member]) -> None:
    """Goes on with runs in turn until the last one has ended."""
    stacks = _seat(members)
    going = list(members)
    try:
        while going:
            for member in going:
                member.take_turn()
            going = [member for member in going if member.ending is None]
            before = time.process_time()
            for stack in stacks:
                stack.catch_up()
            spent_s = time.process_time() - before
            for member in going:
                member.meter.add(spent_s / len(going))
    except BaseException as error:
        for member in members:
            member.give_up(error)
        raise


def _seat(members: Sequence[_Member]) -> list[Stack]:
    """Begins the runs, in stacks of the robots and of the access points unless one is alone."""
    if len(members) < 2:
        for member in members:
            member.begin(Share(clock=member.meter))
        return []
    robots, aps = Stack(len(members)), Stack(len(members))
    for seat, member in enumerate(members):
        member.begin(Share(len(members), robots.seat(seat), aps.seat(seat), member.meter))
    return [robots, aps]


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
        index: its place among those that were asked for.
        config: its configuration.
        meter: its processor time.
        ending: what became of it; None as long as it goes on.
    """

    def __init__(
        self, index: int, config: Config, folder: Path, resumed: Checkpoint | None
    ) -> None:
        self.index, self.config, self.meter = index, config, Meter()
        self._folder, self._resumed = folder, resumed
        self.ending: Ending | None = None

    def begin(self, share: Share) -> None:
        """Makes ready for the first turn."""
        self._turns = local.turns(self.config, self._folder, share, self._resumed)

    def take_turn(self) -> None:
        """Goes on to the next pause, or to the end."""
        with self.meter.running():
            try:
                next(self._turns)
            except StopIteration as end:
                self.ending = finite(end.value)
            except Exception as error:
                self.ending = error

    def give_up(self, error: BaseException) -> None:
        """Lets the run close what it holds and say why it stopped."""
        with suppress(BaseException):
            self._turns.throw(error)
