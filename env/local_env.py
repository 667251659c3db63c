"""A robot's local environment: its task, its observations and its rewards.

A robot receives only what it could measure, its cell, its direct channel, whether it has arrived,
and what the access point tells it: what it is credited with, by default its rate, and with
``state.others`` what other robots do. Observation and reward are computed from that
here, on the robot's side.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from env.arrays import Bools, Floats, Floats32
from env.mdp.observation import CHANNEL, scaled_channel
from env.scenario import Scenario


class LocalEnv:
    """The local environments of n robots, each in one world or in several.

    Arrays have a row for each robot in each of its worlds, in all n = robots * worlds: first the
    worlds of the first robot.

    Args:
        scenario: of these robots alone (``Scenario.of``).
        worlds: how many each robot is in.

    Attributes:
        cells: how many the floor has.
        observation_size: of s_L, of which the access point tells the last ``broadcast_size``.
    """

    def __init__(self, scenario: Scenario, worlds: int = 1) -> None:
        self._rewards, self._distance_m = scenario.rewards, scenario.distance_m
        self._robot = np.repeat(np.arange(len(scenario.destinations)), worlds)
        self.cells = len(self._distance_m)
        self.observation_size = scenario.observer.local_size
        self.broadcast_size = scenario.observer.broadcast_size
        everywhere = np.broadcast_to(np.arange(self.cells)[:, None], self._distance_m.shape)
        silence_db = np.zeros(everywhere.shape, np.float32)
        self._standing = scenario.local_states(everywhere, silence_db)  # all but the channel

    def observe(
        self, cell: NDArray[np.int32], channel_db: Floats32, broadcast: Floats32 | None = None
    ) -> Floats32:
        """s_L of each robot, shape (n, observation_size).

        Args:
            cell: where it is, shape (n,).
            channel_db: |hbar|^2 in dB as it measures it, shape (n,).
            broadcast: what the access point tells it, shape (n, broadcast_size); None if 0.

        Raises:
            ValueError: the broadcast is missing.
        """
        state = self._standing[cell, self._robot]
        state[:, CHANNEL] = scaled_channel(channel_db)
        if not self.broadcast_size:
            return state
        if broadcast is None:
            raise ValueError("env.state.others: robots need what the access point tells them")
        return np.concatenate([state, broadcast], axis=-1, dtype=np.float32)

    def reward(
        self, credit: Floats, left: NDArray[np.int32], reached: NDArray[np.int32], arrived: Bools
    ) -> Floats:
        """r_L of each robot, unscaled: Eq. (11), or the user's own reward; all of shape (n,).

        Args:
            credit: R_k in bit/s/Hz, or what ``reward.credit`` puts in its place.
            left: the cell that each robot left.
            reached: the cell that it moved to.
            arrived: whether that is its destination.
        """
        before = self._distance_m[left, self._robot]
        after = self._distance_m[reached, self._robot]
        return self._rewards.of_robots(credit, before, after, arrived)
