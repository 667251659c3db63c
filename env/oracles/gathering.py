"""Robots that drive about and measure: what they would report to the access point."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np

from env.oracles.per_slot import shortest_directions
from env.radio.measured_map import Reports
from env.seeding import Stream, stream
from env.world import World


def gather(world: World, seed: int, episodes: int, noise_db: float = 0.0) -> list[Reports]:
    """Drives shortest ways from random starts, with a random phase setting in each slot.

    Every episode has a stream of its own, so the first n of many are those of n.

    Args:
        world: the true one; not changed.
        seed: of the starts, the phases and the noise.
        episodes: how many, at least 1.
        noise_db: standard deviation of a measured gain in dB.

    Returns:
        The reports of each episode: one of each robot that drives, slot by slot.
    """
    world = copy.copy(world)  # of its own cells, sharing the tables
    return [
        _episode(world, stream(seed, Stream.GATHERING, number), noise_db)
        for number in range(episodes)
    ]


def joined(reports: Sequence[Reports]) -> Reports:
    """Reports one after another."""
    return Reports(*(np.concatenate(parts) for parts in zip(*reports, strict=True)))


def _episode(world: World, generator: np.random.Generator, noise_db: float) -> Reports:
    """The reports of one episode."""
    world.generator = generator
    world.reset(world.draw_starts(1))
    level, reports = np.ones_like(world.cell), []
    for _ in range(world.config.motion.max_slots):
        phase = generator.integers(world.phase_actions, size=1)
        error_db = noise_db * generator.standard_normal(world.cell.shape)
        gain = world.radio_map.gain(world.cell, phase) * 10.0 ** (error_db / 10.0)
        drives, direct = world.driving, world.direct
        sent = np.full(world.cell.shape, phase)
        reports.append(Reports(world.cell[drives], sent[drives], gain[drives], direct[drives]))
        if world.step(phase, shortest_directions(world), level).terminated.all():
            break
    return joined(reports)
