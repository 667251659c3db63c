"""The access point's side: who steers the RIS, and what a coordinator asks of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from agent import DQN, BranchingDQN, epsilon_at
from conf import Config, ap_network
from env.seeding import Stream, stream
from env.world import StepResult, World
from training.controllers.service import Served, Service


class RisController(Protocol):
    """Who sets the RIS's phases: a DQN, a rule, or one agent that decides for the robots, too."""

    def act(self, state: NDArray[np.float32], tick: int) -> NDArray[np.integer[Any]]:
        """Chooses actions for the states of B worlds, shape (B, global_size).

        Returns:
            Actions, shape (B,): phase settings, or such with a combination of powers.
        """
        ...

    def serve(self, world: World, action: NDArray[np.int64], picks: NDArray[np.int64]) -> Served:
        """What is set once the robots' power picks are known.

        Args:
            world: B worlds; not changed.
            action: what ``act`` chose, shape (B,).
            picks: the robots' power levels, shape (B, K).

        Returns:
            The phase settings, shape (B,), and power levels, shape (B, K).
        """
        ...

    def learn(
        self,
        state: NDArray[np.float32],
        action: NDArray[np.int64],
        outcome: StepResult,
        next_observation: NDArray[np.float32],
    ) -> None:
        """Learns from what actions, as ``act`` chose them, brought; a row for each of B worlds."""
        ...

    def weights(self) -> NDArray[np.float32]:
        """Online and target weights, float32, shape (2, P)."""
        ...

    def state(self) -> dict[str, NDArray[Any]]:
        """All that the agent needs to go on from a window boundary, as copies."""
        ...

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave."""
        ...


class NetworkAgent(ABC):
    """What the ``RisController``s that learn have in common: one network, its start and its state.

    Args:
        config: the run's configuration.

    Attributes:
        shape: of its network.
        agent: its DQN.
    """

    def __init__(self, config: Config) -> None:
        self._config, self.shape = config, ap_network(config)
        self._service = Service(config)
        self._epsilon = config.agent.epsilon
        self.agent = self._new_agent(stream(config.seed, Stream.AP))
        self.agent.load(self.shape.initial_pair(stream(config.seed, Stream.WEIGHTS, 1)))

    @abstractmethod
    def _new_agent(self, generator: np.random.Generator) -> DQN | BranchingDQN:
        """Makes the agent, its weights zero."""

    def serve(self, world: World, action: NDArray[np.int64], picks: NDArray[np.int64]) -> Served:
        """See ``RisController.serve``."""
        return self._service(world, action, picks)

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

    Args:
        config: the run's configuration.
    """

    agent: DQN

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self._always = np.ones(config.train.worlds, dtype=bool)

    def _new_agent(self, generator: np.random.Generator) -> DQN:
        agent, worlds = self._config.agent, self._config.train.worlds
        return DQN(self.shape, agent, agent.discount.ap, [generator], worlds=worlds)

    def act(self, state: NDArray[np.float32], tick: int) -> NDArray[np.integer[Any]]:
        """See ``RisController.act``."""
        return self.agent.act(state, epsilon_at(self._epsilon, tick), self._always)

    def learn(
        self,
        state: NDArray[np.float32],
        action: NDArray[np.int64],
        outcome: StepResult,
        next_observation: NDArray[np.float32],
    ) -> None:
        """See ``RisController.learn``: stores a transition and takes one gradient step."""
        reward, terminal = outcome.global_reward, outcome.terminated
        self.agent.learn(
            state, action.astype(np.int32), reward, next_observation, terminal, self._always
        )
