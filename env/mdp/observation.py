"""What agents see: the local and the global state, scaled to about one."""

from __future__ import annotations

import numpy as np

from env.arrays import Bools, Complexes, Floats, Floats32, Ints
from env.config import EnvConfig
from env.downlink.access import decoding_order
from env.geometry.floor import Floor
from env.mdp.reward import shares

CHANNEL_MIDDLE_DB = 70.0
CHANNEL_SPREAD_DB = 20.0
CHANNEL = 2
"""Where the channel stands in a robot's own state."""
WAY_SIZE = 5
WAY_BOUND = 10.0
"""Most that is seen of the way left; so much is seen where there is none."""
LEAD_BOUND = 2.0
"""Most that is seen of how many slots more or fewer another robot will have driven."""
PACE_BOUND = 4.0
"""Most that is seen of a short way: the horizon over the slots of a robot."""
LAST = np.iinfo(np.int64).max


def scaled_channel(channel_db: Floats32) -> Floats32:
    """A measured channel |hbar|^2 in dB as agents see it, same shape."""
    return (channel_db + CHANNEL_MIDDLE_DB) / CHANNEL_SPREAD_DB


class ObservationEncoder:
    """Builds observations from cells and measured channels; knows the room, not the robots.

    A robot's own state is q / 15 - 1, (hbar_dB + 70) / 20 and, with
    ``state.destination=offset``, (q_D - q) / 30, in a room of 30 m. With ``state.way`` its way
    over the floor follows, see ``way``, and with ``state.others`` what the AP tells it of other
    robots, see ``broadcast``. The AP's holds for each robot q / 15 - 1,
    (hbar_dB + 70) / 20, cos and sin of arg hbar, 1 while driving, and the offset likewise; zeros
    for a robot that is not driving. With ``state.weights`` each robot's share of the weight of all
    that drive comes last, with ``state.order=gain`` robots stand by their channels. Eqs. (6), (9).

    Args:
        config: the environment.

    Attributes:
        own_size: how many numbers of s_L the AP sees too: position, channel, offset.
        has_way: whether s_L has the way.
        broadcast_size: how many numbers of s_L the AP tells a robot.
        has_weights: whether s_G has weights.
        arranges: whether s_G is more than what is seen of each robot by itself, in turn.
        local_size: of s_L.
        global_size: of s_G.
    """

    def __init__(self, config: EnvConfig) -> None:
        floor = Floor.from_config(config)
        self._centres = floor.centres()
        self._size_m = floor.size_m
        self._offset = config.state.destination == "offset"
        self._way_scale = 2.0 / (floor.rows + floor.columns)
        self.own_size = 5 if self._offset else 3
        self.has_way = _has_way(config)
        self._others = min(config.state.others, config.robots - 1)
        self._horizon_slots = config.reward.horizon_slots
        self.broadcast_size = self._others * (2 + self.own_size) + (self._others > 0)
        self._alone_size = self.own_size + WAY_SIZE * self.has_way
        self.local_size = self._alone_size + self.broadcast_size
        self.has_weights, self._by_gain = config.state.weights, config.state.order == "gain"
        self.arranges = self.has_weights or self._by_gain
        self.global_size = config.robots * (self.own_size + 3 + self.has_weights)

    def local(
        self, cell: Ints, channel_db: Floats32, destination: Ints, way: Floats32 | None = None
    ) -> Floats32:
        """The robots' states s_L as they know them by themselves, Eq. (9).

        Args:
            cell: where each robot is, shape (..., K).
            channel_db: |hbar_k|^2 in dB, shape (..., K).
            destination: where each is going, a cell, shape (K,).
            way: with ``has_way`` the way of each, shape (..., K, WAY_SIZE).

        Returns:
            States, shape (..., K, local_size - broadcast_size).
        """
        position = self._centres[cell]
        state = np.empty((*cell.shape, self._alone_size), dtype=np.float32)
        state[..., 0:2] = position / (self._size_m / 2.0) - 1.0
        state[..., CHANNEL] = scaled_channel(channel_db)
        if self._offset:
            state[..., 3:5] = (self._centres[destination] - position) / self._size_m
        if way is not None:
            state[..., self.own_size :] = way
        return state

    def way(self, slots_to_go: Ints, slots_then: Ints) -> Floats32:
        """What a robot knows of its way from its plan of the floor, shape (..., K, WAY_SIZE).

        For each move the slots that it saves, 1, 0 or -1, and the slots left over half of the
        floor's rows and columns, at most ``WAY_BOUND``.

        Args:
            slots_to_go: fewest slots from where each robot is, shape (..., K).
            slots_then: the same after each of the four moves, shape (..., K, 4).
        """
        way = np.empty((*slots_to_go.shape, WAY_SIZE), dtype=np.float32)
        way[..., :4] = slots_to_go[..., None] - slots_then
        way[..., 4] = np.minimum(slots_to_go * self._way_scale, WAY_BOUND)
        return way

    def broadcast(self, local: Floats32, travel_slots: Ints, driving: Bools) -> Floats32:
        """What the AP tells each robot k of the others and of itself, the end of s_L.

        Of as many others j as ``state.others`` says, the driving ones with the fewest slots T_j
        first, by index where equal: 1 while driving, (T_j - T_k) / T_h, and j's own position,
        channel and offset; zeros for one that is not driving. Last, T_h / T_k.

        Args:
            local: the robots' states, shape (B, K, own_size or more).
            travel_slots: T_k, shape (B, K).
            driving: which robots are driving, shape (B, K).

        Returns:
            What is told, shape (B, K, broadcast_size).
        """
        (rows, robots), size = driving.shape, 2 + self.own_size
        told = np.zeros((rows, robots, self.broadcast_size), dtype=np.float32)
        if not self._others:
            return told
        # All robots by T_j; each row leaves one of them out, the robot that is told.
        order = np.where(driving, travel_slots, LAST).argsort(axis=-1, kind="stable")
        every = np.broadcast_to(order[:, None, :], (rows, robots, robots))
        kept = every != np.arange(robots)[:, None]
        other = every[kept].reshape(rows, robots, robots - 1)[..., : self._others]
        row = np.arange(rows)[:, None, None]
        seen = np.empty((*other.shape, size), dtype=np.float32)
        seen[..., 0] = 1.0
        lead = (travel_slots[row, other] - travel_slots[..., None]) / self._horizon_slots
        seen[..., 1] = np.clip(lead, -LEAD_BOUND, LEAD_BOUND)
        seen[..., 2:] = local[row, other, : self.own_size]
        seen = np.where(driving[row, other][..., None], seen, np.float32(0.0))
        told[..., :-1] = seen.reshape(rows, robots, -1)
        told[..., -1] = np.minimum(self._horizon_slots / travel_slots, PACE_BOUND)
        return told

    def seen_robots(self, local: Floats32, channel: Complexes, driving: Bools) -> Floats32:
        """What the AP sees of each robot by itself, zeros where it is not driving.

        Args:
            local: the robots' states, shape (..., K, own_size or more).
            channel: hbar_k, shape (..., K).
            driving: which robots are driving, shape (..., K).

        Returns:
            What is seen, shape (..., K, own_size + 3).
        """
        seen = np.empty((*driving.shape, self.own_size + 3), dtype=np.float32)
        seen[..., 0:3] = local[..., 0:3]
        unit = channel / np.abs(channel)
        seen[..., 3] = unit.real
        seen[..., 4] = unit.imag
        seen[..., 5] = 1.0
        seen[..., 6:] = local[..., 3 : self.own_size]
        seen *= driving[..., None]
        return seen

    def global_observation(
        self, seen: Floats32, channel: Complexes, driving: Bools, weights: Floats | None = None
    ) -> Floats32:
        """The AP's state s_G, Eq. (6), shape (..., global_size).

        Args:
            seen: of each robot, ``seen_robots``.
            channel: hbar_k, shape (..., K).
            driving: which robots are driving, shape (..., K).
            weights: with ``has_weights`` w_k, shape (..., K).
        """
        if weights is not None:
            share = shares(weights, driving).astype(np.float32)
            seen = np.concatenate([seen, share[..., None]], axis=-1)
        if self._by_gain:
            order = decoding_order(channel.real**2 + channel.imag**2, driving)
            seen = np.take_along_axis(seen, order[..., None], axis=-2)
        return seen.reshape(*driving.shape[:-1], self.global_size)


def _has_way(config: EnvConfig) -> bool:
    """Whether robots see their way: as ``state.way`` says, or where walls stop them."""
    if config.state.way == "auto":
        return config.walls.block_motion
    return config.state.way == "on"
