"""Playing a building's frozen weights, room by room, in rooms trained in and rooms held out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conf import Config
from conf.rooms import Room
from training.evaluation import Evaluator
from training.recording.history import MEASURES, Evaluation, evaluate, mean

Weights = NDArray[np.float32]
Measures = dict[str, float]


@dataclass(frozen=True)
class RoomScore:
    """What frozen weights are worth in a room."""

    room: Room
    found: Evaluation


class RoomsEvaluator:
    """Evaluators of some of a building's rooms, made when they are first played in.

    Attributes:
        rooms: those that are played in while training: at most ``rooms.evaluated`` of each kind,
            evenly over all.
    """

    def __init__(self, config: Config, rooms: Sequence[Room]) -> None:
        self._config = config
        most = config.rooms.evaluated
        kinds = [[room for room in rooms if room.held_out == held] for held in (False, True)]
        self.rooms = [room for kind in kinds for room in _spread(kind, most)]
        self._evaluators: list[Evaluator] = []

    def scores(
        self, model: Weights, ap_of: Callable[[Room], Weights], epsilon: float
    ) -> list[RoomScore]:
        """Plays the held-out starts of each room, with exploration and greedily.

        The robots' online network is of shape (P,), a room's access point's of (P_AP,).
        """
        if not self._evaluators:
            self._evaluators = [Evaluator(room.config(self._config)) for room in self.rooms]
        return [
            RoomScore(room, evaluate(evaluator, model[None], ap_of(room), epsilon))
            for room, evaluator in zip(self.rooms, self._evaluators, strict=True)
        ]


def score(config: Config, room: Room, model: Weights, ap: Weights, epsilon: float) -> RoomScore:
    """Plays one room; arguments as ``RoomsEvaluator.scores``."""
    found = evaluate(Evaluator(room.config(config)), model[None], ap, epsilon)
    return RoomScore(room, found)


def overall(scores: Sequence[RoomScore]) -> tuple[Measures, Measures]:
    """Means over rooms, each counted alike: explored and greedy."""

    def means(rows: list[Measures]) -> Measures:
        names = (*MEASURES, "reward", "slots", "epsilon")
        return {name: mean([row[name] for row in rows]) for name in names}

    return means([each.found.explored for each in scores]), means(
        [each.found.greedy for each in scores]
    )


def _spread(rooms: Sequence[Room], most: int) -> list[Room]:
    """At most so many of some rooms, evenly over all."""
    places = np.linspace(0, len(rooms) - 1, min(most, len(rooms))).round().astype(int)
    return [rooms[place] for place in places]
