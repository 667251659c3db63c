"""Which uploads the server hears: some robots are not asked, and uploads are lost or late.

Only uploads are concerned: robots go on driving, learning and taking what the server sends.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conf import Config
from env.seeding import Stream, stream
from training.exchange.facts import WindowFacts

Weights = NDArray[np.float32]

FATES = ("heard", "late", "lost", "not_asked")
"""What becomes of an upload; a late one counts as such and not again when it comes."""


@dataclass(frozen=True, eq=False)
class Heard:
    """The uploads that take part in a window's average.

    Attributes:
        robots: whose they are, ascending, shape (H,).
        rows: their weights, shape (H, 2, P).
        asked: who was asked to send, ascending.
    """

    robots: NDArray[np.intp]
    rows: Weights
    asked: NDArray[np.intp]


class Reception:
    """Hears those who are asked and whose uploads come.

    A late upload comes a window later, as the step that the robot made: the difference from what
    it had been given, added to what it has uploaded by then, or else to what it holds (as FedBuff
    adds late differences; Nguyen et al., 2022, arXiv:2106.06639). So each robot counts once.
    """

    def __init__(self, config: Config) -> None:
        self._config, self._federation, self._seed = config, config.federation, config.seed
        self._counts = np.zeros(len(FATES), np.int64)
        self._late = np.zeros(0, np.intp)
        self._steps: Weights = np.zeros((0, 0, 0), np.float32)

    def heard(self, window: int, given: Weights, rows: Weights, facts: WindowFacts) -> Heard:
        """Those of a window's uploads that count.

        Args:
            window: its number.
            given: what each robot started the window from, shape (K, 2, P).
            rows: what each has sent, shape (K, 2, P).
            facts: of the window.
        """
        asked = self._asked(window, facts)
        lost, late = self._lost(window, facts)
        fates = [asked & ~lost & ~late, asked & ~lost & late, asked & lost, ~asked]
        self._counts += [fate.sum() for fate in fates]
        there, counted = fates[0].copy(), rows
        if len(self._late):
            counted = np.where(there[:, None, None], rows, given)
            counted[self._late] += self._steps
            there[self._late] = True
        self._late = np.flatnonzero(fates[1])
        self._steps = rows[self._late] - given[self._late]
        robots = np.flatnonzero(there)
        return Heard(robots, counted[robots], np.flatnonzero(asked))

    def _asked(self, window: int, facts: WindowFacts) -> NDArray[np.bool_]:
        """Who is asked: the M with the best channels, or max(C K, 1) robots, drawn.

        The draw is that of McMahan et al. (2017), Algorithm 1. The best channels have the shortest
        uploads; of equal ones the first robot's counts as better.
        """
        robots = len(facts.channel_db)
        asked = np.ones(robots, np.bool_)
        if self._federation.hear is not None:
            asked[:] = False
            asked[np.argsort(-facts.channel_db, kind="stable")[: self._federation.hear]] = True
        if self._federation.fraction < 1:
            count = asked_robots(self._config)
            rng = stream(self._seed, Stream.HEARD, window)
            asked[rng.permutation(robots)[count:]] = False
        return asked

    def _lost(self, window: int, facts: WindowFacts) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Whose uploads are lost, and whose are late if they are not."""
        losses, robots = self._federation.losses, len(facts.channel_db)
        draws = stream(self._seed, Stream.LOSSES, window).random((2, robots))
        lost = draws[0] < losses.probability
        if losses.outage_db is not None:
            lost |= facts.channel_db < losses.outage_db
        return lost, draws[1] < losses.late

    def counts(self) -> dict[str, int]:
        """How many uploads so far were heard, late, lost and not asked for."""
        return dict(zip(FATES, self._counts.tolist(), strict=True))

    def state(self) -> dict[str, NDArray[Any]]:
        """All that it keeps between windows."""
        state: dict[str, NDArray[Any]] = {"counts": self._counts.copy()}
        if len(self._late):
            state |= {"late": self._late, "steps": self._steps}
        return state

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave; nothing is a fresh one."""
        self._counts = np.array(state.get("counts", np.zeros(len(FATES))), np.int64)
        self._late = np.array(state.get("late", ()), np.intp)
        self._steps = np.array(state.get("steps", np.zeros((0, 0, 0))), np.float32)


def asked_robots(config: Config) -> int:
    """How many robots are asked for weights in a window."""
    robots, federation = config.env.robots, config.federation
    if federation.hear is not None:
        return federation.hear
    return max(1, round(federation.fraction * robots))
