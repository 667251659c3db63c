"""DQN agents: replay, exploration and learner of n agents that act and learn in lockstep.

Mnih et al., "Human-level control through deep reinforcement learning", Nature 518 (2015).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent.agents.stack import ReplayAgents
from agent.config import AgentConfig
from agent.exploration import explore
from agent.learning.learner import Learner
from agent.networks.mlp import FloatArray, NetworkShape
from agent.replay import RowLayout


class DQN(ReplayAgents):
    """n independent DQN agents of one shape.

    Agents share nothing but the calls: each has its own weights, moments, replay and random
    stream, and ends in the same bits alone, stacked with others, or moved between stacks.
    """

    def __init__(
        self,
        shape: NetworkShape,
        config: AgentConfig,
        discount: float,
        generators: Sequence[np.random.Generator],
        proximal_mu: float = 0.0,
        worlds: int = 1,
    ) -> None:
        """Makes agents with weights of zero; `load` gives them their first ones.

        Args:
            shape: of each agent's network.
            config: how they learn.
            discount: at least 0 and below 1.
            generators: each agent's own, n of them.
            proximal_mu: FedProx's mu; 0 leaves the term out.
            worlds: E, in each of which every agent acts. Rows of the arrays below are an agent's
                worlds, side by side, and then the next agent's.
        """
        learner = Learner(shape, config, discount, len(generators), proximal_mu)
        super().__init__(shape, config, learner, generators, worlds)
        self._layout = RowLayout(shape.inputs)

    def act(
        self, observations: FloatArray, epsilon: float, active: NDArray[np.bool_]
    ) -> NDArray[np.int32]:
        """Chooses epsilon-greedily.

        Args:
            observations: shape (n E, inputs).
            epsilon: share of random actions.
            active: who acts, shape (n E,).

        Returns:
            Actions, -1 for the idle, shape (n E,).
        """
        each = (len(self), self.worlds)
        choices = explore(self._generators, epsilon, self.shape.actions, active.reshape(each))
        self._learner.choose(observations.reshape(*each, -1), choices)
        return choices.reshape(-1)

    def learn(
        self,
        observations: ArrayLike,
        actions: ArrayLike,
        rewards: ArrayLike,
        next_observations: ArrayLike,
        terminal: ArrayLike,
        active: NDArray[np.bool_],
    ) -> FloatArray:
        """Stores the active agents' transitions and lets those learn that hold enough.

        Args:
            observations: shape (n E, inputs).
            actions: shape (n E,).
            rewards: unscaled, shape (n E,).
            next_observations: shape (n E, inputs).
            terminal: whether the next state is the end, shape (n E,).
            active: who has a transition, shape (n E,).

        Returns:
            Mean losses, nan where no update was made, shape (n,).
        """
        scaled = np.multiply(rewards, self._config.reward_scale)
        self._layout.pack(observations, actions, scaled, next_observations, terminal, self._rows)
        return self._take_rows(active)
