"""One network with a head for each part of a decision: what a head is, and its targets.

Tavakoli, Pardo and Kormushev, "Action branching architectures for deep reinforcement learning",
AAAI 2018: the actions of a decision with H parts are as many as the parts' actions together, not
as their product.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent.learning.losses import td_target
from agent.networks.mlp import FloatArray


@dataclass(frozen=True)
class Heads:
    """The heads of a network, which lie one after the other in its last layer.

    Attributes:
        sizes: actions of each head, H of them.
        discounts: of each, at least 0 and below 1.
        shared: whether all heads learn one value of the whole decision, of one reward, as in the
            paper above; otherwise each learns the value of its own part, of its own reward.
    """

    sizes: tuple[int, ...]
    discounts: tuple[float, ...]
    shared: bool = False

    @property
    def actions(self) -> int:
        """All heads' actions together."""
        return sum(self.sizes)

    @property
    def starts(self) -> NDArray[np.intp]:
        """The place of each head's first action, shape (H,)."""
        return np.cumsum((0, *self.sizes[:-1]), dtype=np.intp)

    def best(self, q: FloatArray) -> NDArray[np.int64]:
        """Each head's best action, from its head's first on, (..., H) of values (..., actions)."""
        parts = np.split(q, self.starts[1:], axis=-1)
        return np.stack([part.argmax(axis=-1) for part in parts], axis=-1)

    def values(self, target_q: FloatArray, chooser_q: FloatArray | None = None) -> FloatArray:
        """Each head's value of the next state, (H, B): `dqn_values`, with a chooser double DQN's.

        The target network's values of s' and the online one's have shape (actions, B).
        """
        if chooser_q is None:
            values: FloatArray = np.maximum.reduceat(target_q, self.starts, axis=0)
            return values
        places = self.best(chooser_q.T).T + self.starts[:, None]
        return np.take_along_axis(target_q, places, axis=0)

    def targets(
        self, rewards: FloatArray, terminal: FloatArray, going_on: FloatArray, values: FloatArray
    ) -> FloatArray:
        """TD targets: of its own part for each head, or of all together.

        Own: r_d + discount_d (1 - terminal_d) V_d(s'). Shared: r + discount times the mean of
        V_d(s') over the heads that still decide in s'; 0 where none does.

        Args:
            rewards: of each head, all the same where they are shared, shape (H, B).
            terminal: 1 where a head's part has ended for good, else 0, shape (H, B).
            going_on: 1 where a head decides in s', else 0, shape (H, B).
            values: V_d(s'), shape (H, B).

        Returns:
            Targets, shape (H, B).
        """
        discounts = np.array(self.discounts, np.float32)[:, None]
        if not self.shared:
            return td_target(rewards, terminal, values, discounts)
        count = np.maximum(going_on.sum(axis=0), 1)
        mean: FloatArray = (going_on * values).sum(axis=0) / count
        return rewards + discounts * mean


class HeadRows:
    """Where the fields of a decision's transition lie in its row.

    A row is (observation, next observation, actions, rewards, terminal, active), the last four of
    H numbers each. A head that is not active had nothing to decide: it learns nothing.
    """

    def __init__(self, inputs: int, heads: int) -> None:
        """Lays out transitions with observations of `inputs` numbers and decisions of `heads`."""
        self.inputs = inputs
        at = [slice(2 * inputs + i * heads, 2 * inputs + (i + 1) * heads) for i in range(4)]
        self.actions, self.rewards, self.terminal, self.active = at
        self.width = 2 * inputs + 4 * heads

    def pack(
        self,
        observations: ArrayLike,
        actions: ArrayLike,
        rewards: ArrayLike,
        next_observations: ArrayLike,
        terminal: ArrayLike,
        active: ArrayLike,
        out: FloatArray,
    ) -> None:
        """Writes transitions into the rows `out`, shape (..., width).

        Observations have shape (..., inputs), all else (..., H), of each head: its action, its
        reward, whether its part has ended and whether it had something to decide.
        """
        out[..., : self.inputs] = observations
        out[..., self.inputs : 2 * self.inputs] = next_observations
        out[..., self.actions] = actions
        out[..., self.rewards] = rewards
        out[..., self.terminal] = terminal
        out[..., self.active] = active
