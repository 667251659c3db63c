"""The spaces in which robots' and access points' observations lie."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces

from env.mdp.observation import ObservationEncoder

CHANNEL_BOUND = 10.0
"""Bound of the channel's entry: |hbar|^2 from -270 to 130 dB, more than any floor has."""


def robot_space(encoder: ObservationEncoder) -> spaces.Box[np.float32]:
    """A new space of a robot's observations s_L: position, channel, offset to the destination."""
    high = np.array([1.0, 1.0, CHANNEL_BOUND] + [1.0] * (encoder.local_size - 3), np.float32)
    return spaces.Box(-high, high, dtype=np.float32)


def ap_space(encoder: ObservationEncoder, robots: int) -> spaces.Box[np.float32]:
    """A space of the access point's observations s_G: of each robot in turn.

    Position, channel, cos and sin of its phase, 1 while driving, offset to the destination.
    """
    each = [1.0, 1.0, CHANNEL_BOUND, 1.0, 1.0, 1.0] + [1.0] * (encoder.local_size - 3)
    high = np.array(each * robots, np.float32)
    low = -high
    low[5 :: len(each)] = 0.0
    return spaces.Box(low, high, dtype=np.float32)
