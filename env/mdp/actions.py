"""A robot's action as one integer: four directions times N_P power levels, Eq. (10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from env.arrays import Ints
from env.config import EnvConfig
from env.geometry.floor import DIRECTIONS


@dataclass(frozen=True)
class ActionSpace:
    """What a robot can choose, and what all agents can choose together.

    Attributes:
        levels: N_P.
    """

    levels: int

    @classmethod
    def from_config(cls, config: EnvConfig) -> ActionSpace:
        """The actions of a configuration's robots."""
        return cls(config.power.levels)

    @property
    def count(self) -> int:
        """Number of actions, 4 N_P."""
        return len(DIRECTIONS) * self.levels

    def encode(self, direction: Ints, level: Ints) -> Ints:
        """Action of a direction index and a power level 1..N_P, any shape."""
        return np.asarray(direction * self.levels + level - 1)

    def decode(self, action: Ints) -> tuple[Ints, Ints]:
        """Direction index and power level 1..N_P of an action, same shape; -1 decodes as 0."""
        direction, level = np.divmod(np.maximum(action, 0), self.levels)
        return direction, level + 1

    def joint_count(self, phases: int, robots: int) -> int:
        """Number of joint actions of an AP with so many phase settings and of K robots."""
        return int(phases * self.count**robots)

    def joint_decode(self, joint: Ints, robots: int) -> tuple[Ints, Ints]:
        """The phase action, shape (...), and the robots' actions, (..., K), of a joint one.

        A joint action is phase (4 N_P)^K + a_0 (4 N_P)^(K-1) + ... + a_{K-1}.
        """
        places = self.count ** np.arange(robots - 1, -1, -1)
        rest = joint % self.count**robots
        return joint // self.count**robots, np.asarray(rest[..., None] // places % self.count)
