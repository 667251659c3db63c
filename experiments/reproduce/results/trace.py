"""What robots are served along their ways, slot by slot: learned policies and planned ones."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from conf import Config
from env.episode import EpisodeMeasures
from env.world import World
from experiments.analysis import optimality_gap
from experiments.analysis.optimality_gap import SLACK
from training.controllers.service import Served
from training.evaluation import Evaluator


@dataclass
class Trace:
    """The slots of B episodes, as they are played; ``see`` fits ``Evaluator.play``.

    Attributes:
        cells: where the robots are in each slot, T arrays of shape (B, K).
        driving: which of them drive.
        gains: |h_k|^2 under the phase that is set.
        rates: R_k in bit/s/Hz.
    """

    cells: list[NDArray[np.int64]] = field(default_factory=list)
    driving: list[NDArray[np.bool_]] = field(default_factory=list)
    gains: list[NDArray[np.float64]] = field(default_factory=list)
    rates: list[NDArray[np.float64]] = field(default_factory=list)

    def see(self, world: World, served: Served) -> Served:
        """Notes a slot before the world moves on; returns what is served, unchanged."""
        phase, level = served
        gain = np.abs(world.channel(phase)) ** 2
        self.cells.append(world.cell)
        self.driving.append(world.driving)
        self.gains.append(gain)
        self.rates.append(world.downlink.allocate(gain, level, world.driving).rate)
        return served

    @property
    def gain_db(self) -> NDArray[np.float64]:
        """Gains in dB, nan where a robot does not drive, shape (T, B, K)."""
        return np.where(np.stack(self.driving), 10.0 * np.log10(np.stack(self.gains)), np.nan)

    @property
    def rate(self) -> NDArray[np.float64]:
        """Rates in bit/s/Hz, nan where a robot does not drive, shape (T, B, K)."""
        return np.where(np.stack(self.driving), np.stack(self.rates), np.nan)


@dataclass(frozen=True)
class PlayedEpisodes:
    """Episodes that have been played.

    Attributes:
        measures: of each.
        along: their slots.
        end: the cells where the robots ended, shape (B, K).
        world: where they were played.
    """

    measures: EpisodeMeasures
    along: Trace
    end: NDArray[np.int64]
    world: World

    @property
    def ways_m(self) -> NDArray[np.float64]:
        """Positions in m, the last one included, shape (T + 1, B, K, 2)."""
        return np.asarray(self.world.floor.centres()[np.stack([*self.along.cells, self.end])])

    @property
    def destinations_m(self) -> NDArray[np.float64]:
        """Shape (K, 2)."""
        return np.asarray(self.world.floor.centres()[self.world.destinations])

    @property
    def gain_db(self) -> float:
        """The mean gain in dB over all slots in which a robot drives."""
        return float(np.nanmean(self.along.gain_db))


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
    along = Trace()
    (measures,) = evaluator.play(*weights, (epsilon,), serve=along.see)
    return PlayedEpisodes(measures, along, evaluator.world.cell, evaluator.world)


def planned(evaluator: Evaluator, slack: int = SLACK) -> PlayedEpisodes:
    """Plans the episodes' best trajectories (``env.oracles.trajectory``) and plays them.

    Args:
        evaluator: the episodes.
        slack: extra slots that a robot may take.
    """
    along = Trace()
    measures = optimality_gap.trajectory_measures(evaluator, slack, watch=along.see)
    return PlayedEpisodes(measures, along, evaluator.world.cell, evaluator.world)


def mirrored(config: Config) -> Evaluator:
    """One episode in which each robot starts opposite its destination.

    The paper does not say where the robots of its Fig. 5 start. Here the start is the destination
    turned half round the room's centre: with the default task all three robots start on the access
    point's side of the wall and end on the other, 30 to 40 m away by rows and columns.

    Args:
        config: a run's configuration.
    """
    evaluator = Evaluator(config, episodes=1)
    floor = evaluator.world.floor
    opposite_m = np.asarray(floor.size_m) - floor.centres()[evaluator.world.destinations]
    evaluator.starts = floor.cell_at(opposite_m)[None]
    return evaluator
