"""Who steers the RIS with a network of its own: the access point, in the first place."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent import DQN, BranchingDQN, epsilon_at
from conf import Config, ap_network
from env.seeding import Stream, stream
from env.world import StepResult
from training.controllers.service import Actions, RisController, States


class NetworkAgent(RisController):
    """What the ``RisController``s that learn have in common: one network, its start and its state.

    Attributes:
        shape: of its network.
        agent: its DQN.
    """

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.shape, self._epsilon = ap_network(config), config.agent.epsilon
        self._always = np.ones(config.train.worlds, dtype=bool)
        self.agent = self._new_agent(stream(config.seed, Stream.AP))
        self.agent.load(self.shape.initial_pair(stream(config.seed, Stream.WEIGHTS, 1)))

    @abstractmethod
    def _new_agent(self, generator: np.random.Generator) -> DQN | BranchingDQN:
        """Makes the agent, its weights zero."""

    def _new_dqn(self, discount: float, generator: np.random.Generator) -> DQN:
        config = self._config
        return DQN(self.shape, config.agent, discount, [generator], worlds=config.train.worlds)

    def weights(self) -> NDArray[np.float32]:
        """See ``RisController.weights``."""
        return np.asarray(self.agent.weights()[0])

    def state(self) -> dict[str, NDArray[Any]]:
        """See ``RisController.state``."""
        return self.agent.agent_state(0)

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """See ``RisController.restore``."""
        self.agent.restore_agent(0, state)


class AccessPoint(NetworkAgent):
    """The global DQN of Section III-A: it sees all robots and picks the RIS's phases.

    With ``scheme.power=ap`` it picks the robots' powers in the same action.
    """

    agent: DQN

    def _new_agent(self, generator: np.random.Generator) -> DQN:
        return self._new_dqn(self._config.agent.discount.ap, generator)

    def act(self, state: States, tick: int) -> NDArray[np.integer[Any]]:
        """See ``RisController.act``."""
        return self.agent.act(state, epsilon_at(self._epsilon, tick), self._always)

    def learn(self, state: States, action: Actions, outcome: StepResult, seen: States) -> None:
        """See ``RisController.learn``: stores a transition and takes one gradient step."""
        reward, ended = outcome.global_reward, outcome.terminated
        self.agent.learn(state, action.astype(np.int32), reward, seen, ended, self._always)
