"""What agents see: the local and the global state, scaled to about one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from env.config import EnvConfig
from env.geometry.floor import Floor

CHANNEL_MIDDLE_DB = 70.0
CHANNEL_SPREAD_DB = 20.0
CHANNEL = 2
"""Where the channel stands in a robot's own state."""


def scaled_channel(channel_db: NDArray[np.float32]) -> NDArray[np.float32]:
    """A measured channel |hbar|^2 in dB as agents see it, same shape."""
    return (channel_db + CHANNEL_MIDDLE_DB) / CHANNEL_SPREAD_DB


class ObservationEncoder:
    """Builds observations from cells and measured channels; knows the room, not the robots.

    A robot's own state is q / 15 - 1, (hbar_dB + 70) / 20 and, with
    ``state.destination=offset``, (q_D - q) / 30, in a room of 30 m. The AP's holds for each robot
    q / 15 - 1, (hbar_dB + 70) / 20, cos and sin of arg hbar, 1 while driving, and the offset
    likewise; zeros for a robot that is not driving. Eqs. (6) and (9).

    Args:
        config: the environment.
    """

    def __init__(self, config: EnvConfig) -> None:
        floor = Floor.from_config(config)
        self._centres = floor.centres()
        self._size_m = floor.size_m
        self._offset = config.state.destination == "offset"
        self.local_size = 5 if self._offset else 3
        self.global_size = config.robots * (8 if self._offset else 6)

    def local(
        self,
        cell: NDArray[np.int64],
        channel_db: NDArray[np.float32],
        destination: NDArray[np.int64],
    ) -> NDArray[np.float32]:
        """The robots' states s_L, Eq. (9).

        Args:
            cell: where each robot is, shape (..., K).
            channel_db: |hbar_k|^2 in dB, shape (..., K).
            destination: where each is going, a cell, shape (K,).

        Returns:
            States, float32, shape (..., K, local_size).
        """
        position = self._centres[cell]
        state = np.empty((*cell.shape, self.local_size), dtype=np.float32)
        state[..., 0:2] = position / (self._size_m / 2.0) - 1.0
        state[..., CHANNEL] = scaled_channel(channel_db)
        if self._offset:
            state[..., 3:5] = (self._centres[destination] - position) / self._size_m
        return state

    def global_observation(
        self,
        local: NDArray[np.float32],
        channel: NDArray[np.complex128],
        driving: NDArray[np.bool_],
    ) -> NDArray[np.float32]:
        """The AP's state s_G, Eq. (6).

        Args:
            local: the robots' states, shape (..., K, local_size).
            channel: hbar_k, shape (..., K).
            driving: which robots are driving, shape (..., K).

        Returns:
            State, float32, shape (..., global_size).
        """
        robots = driving.shape[-1]
        state = np.empty((*driving.shape, self.global_size // robots), dtype=np.float32)
        state[..., 0:3] = local[..., 0:3]
        unit = channel / np.abs(channel)
        state[..., 3] = unit.real
        state[..., 4] = unit.imag
        state[..., 5] = 1.0
        state[..., 6:] = local[..., 3:]
        state *= driving[..., None]
        return state.reshape(*driving.shape[:-1], self.global_size)
