"""Episodes as policies, rules and plans drive them, with all that happens on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conf import Config
from env.episode import EpisodeMeasures
from env.world import World
from experiments.analysis.optimality_gap import (
    SLACK,
    shortest_best_measures,
    trajectory_measures,
)
from training.controllers.service import Served
from training.evaluation import Evaluator
from training.trace import Trace


@dataclass(frozen=True)
class PlayedEpisodes:
    """Episodes that have been played.

    Attributes:
        measures: of each.
        along: their slots.
        world: where they were played.
    """

    measures: EpisodeMeasures
    along: Trace
    world: World

    @property
    def ways_m(self) -> NDArray[np.float64]:
        """Positions in m, the last one included, shape (T + 1, B, K, 2)."""
        return self.along.ways_m(self.world)

    @property
    def destinations_m(self) -> NDArray[np.float64]:
        """Shape (K, 2)."""
        return np.asarray(self.world.floor.centres()[self.world.destinations])

    @property
    def gain_db(self) -> float:
        """The mean gain in dB over all slots in which a robot drives."""
        return float(np.nanmean(self.along.gain_db))


def _played(
    evaluator: Evaluator, play: Callable[[Callable[[World, Served], Served]], EpisodeMeasures]
) -> PlayedEpisodes:
    """Plays an evaluator's episodes by a function that shows each slot to what it is given."""
    along = Trace()
    measures = play(along.see)
    along.finish(evaluator.world)
    return PlayedEpisodes(measures, along, evaluator.world)


def learned(
    evaluator: Evaluator,
    weights: tuple[NDArray[np.float32], NDArray[np.float32]],
    epsilon: float,
) -> PlayedEpisodes:
    """Plays frozen weights.

    Args:
        evaluator: the episodes.
        weights: online weights of robots, (K, P), and access point, (P_AP,).
        epsilon: probability of a random action.
    """
    return _played(evaluator, lambda see: evaluator.play(*weights, (epsilon,), serve=see)[0])


def planned(evaluator: Evaluator) -> PlayedEpisodes:
    """Plans the episodes' best trajectories (``env.oracles.trajectory``) and plays them."""
    return _played(evaluator, lambda see: trajectory_measures(evaluator, SLACK, watch=see))


def ruled(evaluator: Evaluator) -> PlayedEpisodes:
    """Plays the best rule: shortest ways with the phases and powers that serve (5a) best."""
    return _played(evaluator, lambda see: shortest_best_measures(evaluator, see))


def mirrored(config: Config) -> Evaluator:
    """One episode in which each robot starts opposite its destination.

    The paper does not say where the robots of its Fig. 5 start. Here the start is the destination
    turned half round the room's centre: with the default task all three robots start on the access
    point's side of the wall and end on the other, 30 to 40 m away by rows and columns.
    """
    evaluator = Evaluator(config, episodes=1)
    floor = evaluator.world.floor
    opposite_m = np.asarray(floor.size_m) - floor.centres()[evaluator.world.destinations]
    evaluator.starts = floor.cell_at(opposite_m)[None]
    return evaluator
