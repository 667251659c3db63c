"""What happens in episodes slot by slot, kept for whoever draws or counts it later."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from env.episode import EpisodeMeasures
from env.world import World
from training.controllers.service import Served

SHOWN = ("success", "ee", "ee_bits_per_joule", "sum_rate", "min_rate", "slots")
"""Measures that stand beside a recorded episode."""


class Trace:
    """The slots of episodes as they are played; ``see`` fits ``Evaluator.play``.

    Args:
        worlds: which of the worlds to keep, B of them; all by default.

    Attributes:
        cells: where the robots are in each slot, and, after ``finish``, where they end: T + 1
            arrays of shape (B, K).
        driving: which of them drive, T arrays of shape (B, K).
        gains: |h_k|^2 under the phase that is set, likewise.
        rates: R_k in bit/s/Hz, likewise.
        powers_w: p_k in W, likewise.
        orders: the robot at each rank, strongest channel first, likewise.
        phases: the access point's actions, T arrays of shape (B,).
    """

    def __init__(self, worlds: slice = slice(None)) -> None:
        self._worlds = worlds
        self.cells: list[NDArray[np.int64]] = []
        self.driving: list[NDArray[np.bool_]] = []
        self.gains: list[NDArray[np.float64]] = []
        self.rates: list[NDArray[np.float64]] = []
        self.powers_w: list[NDArray[np.float64]] = []
        self.orders: list[NDArray[np.int64]] = []
        self.phases: list[NDArray[np.int64]] = []

    def see(self, world: World, served: Served) -> Served:
        """Notes a slot before the world moves on; returns what is served, unchanged."""
        kept = self._worlds
        cell, driving = world.cell[kept], world.driving[kept]
        phase, level = (each[kept] for each in served)
        fades = world.config.channel.fading == "slot"
        gain = world.radio_map.gain(cell, phase, world.direct[kept] if fades else None)
        sent = world.downlink.allocate(gain, level, driving)
        self.cells.append(cell)
        self.driving.append(driving)
        self.gains.append(gain)
        self.rates.append(sent.rate)
        self.powers_w.append(sent.power_w)
        self.orders.append(sent.order)
        self.phases.append(phase)
        return served

    def finish(self, world: World) -> None:
        """Notes where the episodes have ended."""
        self.cells.append(world.cell[self._worlds])

    @property
    def gain_db(self) -> NDArray[np.float64]:
        """Gains in dB, nan where a robot does not drive, shape (T, B, K)."""
        return np.where(np.stack(self.driving), 10.0 * np.log10(np.stack(self.gains)), np.nan)

    @property
    def rate(self) -> NDArray[np.float64]:
        """Rates in bit/s/Hz, nan where a robot does not drive, shape (T, B, K)."""
        return np.where(np.stack(self.driving), np.stack(self.rates), np.nan)

    def ways_m(self, world: World) -> NDArray[np.float64]:
        """Positions in m, those at the end included, shape (T + 1, B, K, 2)."""
        return np.asarray(world.floor.centres()[np.stack(self.cells)])


def recorded(trace: Trace, world: World, measures: EpisodeMeasures) -> dict[str, Any]:
    """The first episode of a trace, after ``finish``, in the form of ``episode.json``.

    Args:
        trace: of episodes.
        world: where they were played.
        measures: of them.

    Returns:
        "cells", those at the end included, (T + 1, K); for each of T slots "driving", "rates" in
        bit/s/Hz, "powers_w", "gains_db", each (T, K); "order", the driving robots, weakest channel
        first, in which NOMA's signals are decoded; "phases_deg" of the sub-surfaces, (T, N), or
        "beams", (T,); and the measures in ``SHOWN``.
    """
    slots = int(measures.slots[0])

    def first(arrays: Sequence[NDArray[Any]], count: int = slots) -> NDArray[Any]:
        return np.stack(arrays[:count])[:, 0]

    driving, gains = first(trace.driving), first(trace.gains)
    order = first(trace.orders)[:, ::-1]
    drives = np.take_along_axis(driving, order, axis=1)
    return {
        "cells": first(trace.cells, slots + 1).tolist(),
        "driving": driving.astype(int).tolist(),
        "rates": first(trace.rates).round(4).tolist(),
        "powers_w": first(trace.powers_w).round(6).tolist(),
        "gains_db": (10.0 * np.log10(gains)).round(1).tolist(),
        "order": [robots[there].tolist() for robots, there in zip(order, drives, strict=True)],
        **_phases(world, first(trace.phases)),
        **{name: float(getattr(measures, name)[0]) for name in SHOWN},
    }


def _phases(world: World, actions: NDArray[np.int64]) -> Mapping[str, Any]:
    """What the RIS is set to in each slot, by the access point's actions, shape (T,)."""
    if world.radio_map.codebook:
        return {"beams": actions.tolist()}
    degrees = np.degrees(np.angle(world.radio_map.settings[actions])).round() % 360.0
    return {"phases_deg": degrees.astype(int).tolist()}
