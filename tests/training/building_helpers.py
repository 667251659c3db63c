"""Hosts of rooms for the tests of buildings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from experiments.runtimes.local import LocalRooms
from training.recording.costs import Costs
from training.recording.history import METRICS
from training.rooms import RoomReport, RoundTask


class LossyRooms(LocalRooms):
    """All rooms in this process, some of which some rounds do not reach.

    Attributes:
        lost: rooms that miss a round, by its number.
        backwards: whether reports come in the opposite order.
        asked: the tasks of all rounds.
        played: the reports of all rounds.
    """

    def __init__(self, config: Any, state: Path | None, lost: Mapping[int, tuple[int, ...]]):
        super().__init__(config, state)
        self.lost, self.backwards = lost, False
        self.asked: list[RoundTask] = []
        self.played: list[dict[int, RoomReport]] = []

    def play(self, task: RoundTask) -> dict[int, RoomReport]:
        """See ``RoomHost.play``."""
        missing = self.lost.get(task.number, ())
        reached = [each for each in task.rooms if each.room.index not in missing]
        reached = reached[::-1] if self.backwards else reached
        reports = super().play(RoundTask(task.number, task.model, task.keep, reached, task.played))
        self.asked.append(task)
        self.played.append(reports)
        return reports


class StandIns:
    """A host whose rooms come to what a function says, without a world.

    Args:
        says: the weights of a room from its index, the model it takes and the AP's, if any.
    """

    forgets = False

    def __init__(self, says: Callable[..., tuple[Any, Any]]) -> None:
        self.says = says
        self.asked: list[RoundTask] = []
        self.aps: dict[int, Any] = {}

    def play(self, task: RoundTask) -> dict[int, RoomReport]:
        """See ``RoomHost.play``."""
        self.asked.append(task)
        reports = {}
        for each in task.rooms:
            index = each.room.index
            before = self.aps.get(index) if each.ap is None else each.ap
            model, self.aps[index] = self.says(index, task.model, before)
            rows = np.zeros((0, len(METRICS)))
            reports[index] = RoomReport(model, self.aps[index], 10 * task.number, rows)
        return reports

    def keep(self) -> None:
        """See ``RoomHost.keep``."""

    def costs(self) -> Costs:
        """See ``RoomHost.costs``."""
        return Costs()

    def clients(self) -> list[dict[str, Any]]:
        """See ``RoomHost.clients``."""
        return []
