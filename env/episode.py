"""Counting what episodes bring: the measures that training, evaluation and oracles share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from env.arrays import Bools, Floats, Ints
from env.mdp.reward import bits_per_joule, energy_efficiency
from env.world import StepResult, World


@dataclass(frozen=True)
class EpisodeMeasures:
    """Measures of episodes, one entry a world.

    Attributes:
        success: share of the robots that arrived, shape (B,).
        path_ratio: slots driven over the shortest length, nan for a robot that did not arrive,
            shape (B, K).
        reward: total of the robots' rewards over robots and slots, unscaled, shape (B,).
        ee: energy efficiency in bit/s/Hz/J, the objective (5a), shape (B,).
        ee_bits_per_joule: all bits over all energy, in bit/J, shape (B,).
        sum_rate: mean over slots of sum_k R_k in bit/s/Hz, shape (B,).
        min_rate: least over robots of a robot's mean rate while driving, shape (B,).
        sic_violations: share of robot-slots whose signal broke Eq. (2) as sent, shape (B,).
        projections: share of slots in which the AP changed the picks, shape (B,).
        slots: length of the episode, shape (B,).
    """

    success: Floats
    path_ratio: Floats
    reward: Floats
    ee: Floats
    ee_bits_per_joule: Floats
    sum_rate: Floats
    min_rate: Floats
    sic_violations: Floats
    projections: Floats
    slots: Ints

    def of(self, worlds: slice | Bools) -> EpisodeMeasures:
        """The measures of some of the worlds."""
        return EpisodeMeasures(*(getattr(self, f.name)[worlds] for f in fields(self)))

    def summary(self) -> dict[str, float]:
        """Means over the episodes; the path ratio's over all robots that arrived."""
        ratios = self.path_ratio[np.isfinite(self.path_ratio)]
        means = {field.name: float(getattr(self, field.name).mean()) for field in fields(self)}
        return means | {"path_ratio": float(ratios.mean()) if len(ratios) else float("nan")}


_COUNTS = ("shortest", "rate_sum", "slots", "arrived", "reward", "failed", "projected")


class EpisodeAccumulator:
    """Adds up the outcomes of the episodes that begin now in every world.

    Args:
        world: the worlds, just reset.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._shortest = world.shortest_slots
        shape = world.cell.shape
        self._rate_sum = np.zeros(shape)
        self._slots = np.zeros(shape, dtype=np.int64)
        self._arrived = np.zeros(shape, dtype=bool)
        self._reward = np.zeros(shape[0])
        self._failed = np.zeros(shape[0], dtype=np.int64)
        self._projected = np.zeros(shape[0], dtype=np.int64)

    def add(self, outcome: StepResult) -> None:
        """Counts one slot."""
        self._rate_sum += outcome.rate
        self._slots += outcome.drove
        self._arrived |= outcome.arrived
        self._reward += outcome.local_reward.sum(axis=-1)
        self._failed += outcome.allocation.sic_failed.sum(axis=-1)
        self._projected += outcome.allocation.projected

    def restart(self, worlds: Bools) -> None:
        """Forgets the episodes of worlds that have just been restarted, shape (B,)."""
        for name in _COUNTS:
            getattr(self, f"_{name}")[worlds] = 0
        self._shortest[worlds] = self._world.shortest_slots[worlds]

    def state(self) -> dict[str, NDArray[Any]]:
        """All that has been counted, as copies; the arrays of ``restore``."""
        return {name: getattr(self, f"_{name}").copy() for name in _COUNTS}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave."""
        for name in _COUNTS:
            setattr(self, f"_{name}", state[name].copy())

    def measures(self) -> EpisodeMeasures:
        """The measures so far, those of whole episodes once all have ended."""
        slots = np.maximum(self._slots, 1)
        length = np.maximum(self._slots.max(axis=-1), 1)
        ratio = self._slots / np.maximum(self._shortest, 1)
        slot_s, config = self._world.slot_s, self._world.config
        return EpisodeMeasures(
            success=self._arrived.mean(axis=-1),
            path_ratio=np.where(self._arrived, ratio, np.nan),
            reward=self._reward.copy(),
            ee=energy_efficiency(self._rate_sum, slots, slot_s, config.motion),
            ee_bits_per_joule=bits_per_joule(
                self._rate_sum, slots, slot_s, config.noise.bandwidth_hz, config.motion
            ),
            sum_rate=self._rate_sum.sum(axis=-1) / length,
            min_rate=(self._rate_sum / slots).min(axis=-1),
            sic_violations=self._failed / slots.sum(axis=-1),
            projections=self._projected / length,
            slots=self._slots.max(axis=-1),
        )
