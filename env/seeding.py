"""Random streams: one seed, a named child for each use, no global generator.

A stream depends on its name alone, so adding one changes no other, and a robot's stream is the
same whichever process holds the robot.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """What the streams of a run are for. Values are part of the results: never renumber."""

    DESTINATIONS = 0
    WEIGHTS = 1
    WORLD = 2
    AP = 3
    ROBOT = 4
    EVALUATION = 5
    RADIO_MAP = 6
    GATHERING = 7
    FLOOR = 8
    ROOM = 9
    HELD_OUT_ROOM = 10
    PARTICIPATION = 11
    PRIVACY = 12
    LOCAL_NOISE = 13
    LOSSES = 16
    HEARD = 17
    ATTACK = 18
    GOSSIP = 19


def stream(seed: int, name: Stream, index: int = 0) -> np.random.Generator:
    """A fresh PCG64 generator of its own for one use, at the start of its stream.

    Args:
        seed: the run's seed (the map's for ``Stream.RADIO_MAP``, the floor's for
            ``Stream.FLOOR``), at least 0.
        name: what the stream is for.
        index: which one, where there are several (robot k).
    """
    return np.random.Generator(np.random.PCG64(_sequence(seed, name, index)))


def derived_seed(seed: int, name: Stream, index: int = 0) -> int:
    """A seed of 32 bits for whatever has streams of its own, such as a room of a building."""
    return int(_sequence(seed, name, index).generate_state(1)[0])


def _sequence(seed: int, name: Stream, index: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(entropy=seed, spawn_key=(int(name), index))
