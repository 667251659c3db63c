"""The access point's agent: one DQN that steers the RIS."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent import DQN, epsilon_at
from conf import Config, ap_network
from env.seeding import Stream, stream


class AccessPoint:
    """The global DQN of Section III-A: it sees all robots and picks the RIS's phases.

    Args:
        config: the run's configuration.
    """

    def __init__(self, config: Config) -> None:
        self._epsilon = config.agent.epsilon
        generator = stream(config.seed, Stream.AP)
        self.shape = ap_network(config)
        self.agent = DQN(self.shape, config.agent, config.agent.discount.ap, [generator])
        first = self.shape.initial_weights(stream(config.seed, Stream.WEIGHTS, 1))
        self.agent.load(np.stack([first, first]))
        self._always = np.ones(1, dtype=bool)

    def act(self, state: NDArray[np.float32], tick: int) -> NDArray[np.int64]:
        """The phase action for a state of shape (1, global_size), as an array of shape (1,)."""
        epsilon = epsilon_at(self._epsilon, tick)
        return self.agent.act(state, epsilon, self._always).astype(np.int64)

    def learn(
        self,
        state: NDArray[np.float32],
        action: NDArray[np.int64],
        reward: NDArray[np.float64],
        following: NDArray[np.float32],
        terminal: NDArray[np.bool_],
    ) -> None:
        """Stores a transition, arrays of one row each, and takes one gradient step."""
        self.agent.learn(state, action.astype(np.int32), reward, following, terminal, self._always)

    def weights(self) -> NDArray[np.float32]:
        """Online and target weights, float32, shape (2, P)."""
        return np.asarray(self.agent.weights()[0])
