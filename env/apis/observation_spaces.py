"""The spaces in which robots' and access points' observations lie."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces

from env.mdp.observation import LEAD_BOUND, PACE_BOUND, WAY_BOUND, ObservationEncoder

CHANNEL_BOUND = 10.0
"""Bound of the channel's entry: |hbar|^2 from -270 to 130 dB, more than any floor has."""

Bounds = tuple[float, float]


def robot_space(encoder: ObservationEncoder) -> spaces.Box[np.float32]:
    """A new space of a robot's observations s_L: position, channel, offset, its way, others."""
    own = _own(encoder)
    bounds = [*own]
    if encoder.has_way:
        bounds += [(-1.0, 1.0)] * 4 + [(0.0, WAY_BOUND)]
    if encoder.broadcast_size:
        other = [(0.0, 1.0), (-LEAD_BOUND, LEAD_BOUND), *own]
        bounds += other * (encoder.broadcast_size // len(other)) + [(0.0, PACE_BOUND)]
    return _box(bounds)


def ap_space(encoder: ObservationEncoder, robots: int) -> spaces.Box[np.float32]:
    """A space of the access point's observations s_G: of each robot in turn.

    Position, channel, cos and sin of its phase, 1 while driving, offset to the destination, its
    share of all weights.
    """
    own, share = _own(encoder), [(0.0, 1.0)] * encoder.has_weights
    return _box([*own[:3], (-1.0, 1.0), (-1.0, 1.0), (0.0, 1.0), *own[3:], *share] * robots)


def _own(encoder: ObservationEncoder) -> list[Bounds]:
    """What robot and access point both see of a robot: position, channel, offset."""
    spare = encoder.own_size - 3
    return [(-1.0, 1.0), (-1.0, 1.0), (-CHANNEL_BOUND, CHANNEL_BOUND), *[(-1.0, 1.0)] * spare]


def _box(bounds: list[Bounds]) -> spaces.Box[np.float32]:
    low, high = np.array(bounds, np.float32).T
    return spaces.Box(low, high, dtype=np.float32)
