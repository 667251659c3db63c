"""Kills processes of real runs by a schedule that a seed draws, and resumes what is left."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from repeatable.checkpoints import newest_arrays, newest_round, round_s
from repeatable.live import LiveError, LiveRun
from repeatable.process_tracker import Deck, aim
from repeatable.processes import Process
from repeatable.records import digest

SIMULATION = ("ServerApp (engine)", "SuperLink", "ClientApp")
DEPLOYMENT = ("ServerApp", "SuperLink", "SuperNode", "ClientApp")
_FATAL = ("ServerApp (engine)", "ServerApp", "SuperLink")
"""Without these nothing goes on, and Flower says so late if at all."""

_LOOK_S = 0.05
_FRESH_S = 1.0
_ASK_S = 2.0
_STEADY_S = 180.0
"""A run without a further round for that long stands still."""


@dataclass(frozen=True)
class Kill:
    """A kill comes ``delay_s`` after the run's folder shows that a round is whole."""

    round: int
    delay_s: float


def schedule(rng: random.Random, kills: int, rounds: int, longest_s: float) -> list[Kill]:
    """Draws when to kill, in order: each at most ``longest_s`` after the end of a round."""
    drawn = sorted(rng.randrange(rounds) for _ in range(kills))
    return [Kill(each, rng.uniform(0.0, longest_s)) for each in drawn]


@dataclass(frozen=True)
class Task:
    """An app, and how it is played: see ``LiveRun``; ``config`` without ``state-dir``."""

    app: Path
    clients: int
    config: str = ""
    deployment: bool = False

    def live(self, folder: Path) -> LiveRun:
        """A run of it that keeps its state in a folder."""
        config = f'{self.config} state-dir="{folder}"'.strip()
        return LiveRun(self.app, self.clients, config, deployment=self.deployment)


@dataclass
class Ending:
    """How a task ended.

    Attributes:
        rounds: how many it played.
        digest: of its model.
        round_s: what one of the last rounds took, in s.
        killed: how many processes.
    """

    rounds: int
    digest: str
    round_s: float
    killed: int


def play(
    task: Task,
    folder: Path,
    kills: Sequence[Kill] = (),
    deck: Deck | None = None,
    tell: Callable[[str], object] = str,
) -> Ending:
    """Plays a task to its end, begun again after each kill that a run does not survive.

    Args:
        task: what to play.
        folder: of its state, absolute.
        kills: when to kill, in order.
        deck: whom to kill.
        tell: is given a line for each kill.

    Raises:
        LiveError: it failed, or stood still, though nothing was killed.
    """
    left = list(kills)
    while True:
        with ThreadPoolExecutor(1) as asker, task.live(folder) as run:
            before = len(left)
            ended = _watched(run, asker, folder, left, deck, tell)
            if ended == "finished:completed":
                break
            if len(left) == before:
                raise LiveError(f"undisturbed, the run ended as {ended}:\n{run.said()}")
    found = newest_arrays(folder)
    if found is None:
        raise LiveError(f"the app has left no checkpoint in state-dir={folder}: see Repeatable")
    rounds, arrays = found
    return Ending(rounds, digest(arrays), round_s(folder), len(kills) - len(left))


def _watched(
    run: LiveRun,
    asker: Executor,
    folder: Path,
    left: list[Kill],
    deck: Deck | None,
    tell: Callable[[str], object],
) -> str:
    """Follows a run to its end, and kills where it is time; what it ended as."""
    further = looked = time.monotonic()
    answer = asker.submit(_state, run)
    at, due, there = newest_round(folder), 0.0, run.roles()
    while True:
        now = time.monotonic()
        if (reached := newest_round(folder)) != at:
            at, further = reached, now
        if left and now - looked > _FRESH_S:  # a look takes longer than a round may
            there, looked = run.roles(), now
        if deck and left and at >= left[0].round:
            due = due or now + left[0].delay_s
            if now >= due and (role := _struck(there, deck)):
                tell(f"{role} killed after round {newest_round(folder)}")
                left.pop(0)
                due = 0.0
                if role in _FATAL:
                    return f"killed {role}"
        if answer.done():
            if (state := answer.result()).startswith("finished"):
                return state
            answer = asker.submit(_state, run)
        if now - further > _STEADY_S:
            return f"standing still after round {at}"
        time.sleep(_LOOK_S)


def _state(run: LiveRun) -> str:
    """A run's state after a while: Flower takes long to say it."""
    time.sleep(_ASK_S)
    return run.state()


def _struck(there: dict[str, list[Process]], deck: Deck) -> str:
    """Kills a process with -9; its role, empty where none is there any more."""
    picked = deck.pick(there)
    target = picked and aim(picked[1])
    return picked[0] if picked and target and target.kill() else ""
