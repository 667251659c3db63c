"""A stack: one learner for the agents of several runs that go side by side.

Each run has a seat, which looks to its DQN like a learner of its own. What a DQN asks of a seat is
put off until every run has asked: then `Stack.catch_up` takes all gradient steps and all greedy
choices in a few products. An agent's bits do not depend on its neighbours, so a run ends in those
that it would reach by itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.config import AgentConfig
from agent.exploration import NO_ACTION
from agent.interface import MakeLearner
from agent.learner import Learner
from agent.network import FloatArray, NetworkShape


def goes_together(config: AgentConfig) -> bool:
    """Whether a stack of several runs can hold such agents.

    Their gradient steps come after all runs' turns, so no draw may depend on one within a turn:
    further updates after a transition would, and so would priorities.
    """
    return config.updates == 1 and not config.priority.alpha


class Stack:
    """Agents of several runs, alike in number, network and learning.

    Args:
        seats: runs.
    """

    def __init__(self, seats: int) -> None:
        self._seats = seats
        self._kind: tuple[object, ...] | None = None
        self._learner: Learner
        self._learning: list[bool] = []
        self._copies: list[int] = []
        self._asked: list[tuple[slice, NDArray[np.int32]]] = []

    def seat(self, index: int) -> MakeLearner:
        """What makes the learner of a run's DQN, again from the beginning at every call.

        Args:
            index: the run's, from 0.
        """

        def make(
            shape: NetworkShape,
            config: AgentConfig,
            discount: float,
            agents: int,
            proximal_mu: float = 0.0,
        ) -> Seat:
            self._reserve(shape, config, discount, agents, proximal_mu)
            return Seat(self, self._learner, slice(index * agents, (index + 1) * agents))

        return make

    def catch_up(self) -> None:
        """Does what the seats have been asked for: gradient steps, copies, then choices."""
        if any(self._learning):
            self._learner.update(self._learning)
            self._learning = [False] * len(self._learning)
        for agent in self._copies:
            self._learner.copy_to_target(agent)
        self._copies.clear()
        if self._asked:
            self._learner.choose(self._observations, self._choices)
            for rows, choices in self._asked:
                choices[:] = self._choices[rows]
            self._asked.clear()
            self._choices.fill(NO_ACTION)

    def learn_later(self, rows: slice, learning: Sequence[bool]) -> None:
        """Notes who of a seat's agents take a gradient step."""
        self._learning[rows] = learning

    def copy_later(self, agent: int) -> None:
        """Notes an agent, counted over the stack, whose target follows after its step."""
        self._copies.append(agent)

    def choose_later(
        self, rows: slice, observations: FloatArray, choices: NDArray[np.int32]
    ) -> None:
        """Notes what a seat's agents see, and where their choices go."""
        self._observations[rows] = observations
        self._choices[rows] = choices
        self._asked.append((rows, choices))

    def _reserve(
        self,
        shape: NetworkShape,
        config: AgentConfig,
        discount: float,
        agents: int,
        proximal_mu: float,
    ) -> None:
        """Makes the learner of all, when the first seat is taken.

        Raises:
            ValueError: agents differ, or what they draw waits for a step that is put off.
        """
        if not goes_together(config):
            raise ValueError("a stack takes one step at a time on transitions drawn before it")
        kind = (shape, config, discount, agents, proximal_mu)
        if self._kind is None:
            self._kind = kind
            total = self._seats * agents
            self._learner = Learner(shape, config, discount, total, proximal_mu)
            self._learning = [False] * total
            self._observations: FloatArray = np.zeros((total, shape.inputs), np.float32)
            self._choices = np.full(total, NO_ACTION, np.int32)
        elif kind != self._kind:
            raise ValueError(f"agents that differ cannot share a stack: {kind} and {self._kind}")


class Seat:
    """The agents of one run in a stack; see `agent.interface.Learns`.

    Args:
        stack: whose seat this is.
        learner: of all.
        rows: this run's agents.
    """

    def __init__(self, stack: Stack, learner: Learner, rows: slice) -> None:
        self._stack, self._learner, self._rows = stack, learner, rows
        self.weights, self.moments = learner.weights[rows], learner.moments[rows]
        self.steps, self.anchor = learner.steps[rows], learner.anchor[rows]
        self.batch, self.weighing = learner.batch[rows], learner.weighing
        for array in (self.weights, self.moments, self.steps, self.anchor):
            array.fill(0)

    def update(self, learning: Sequence[bool]) -> FloatArray:
        """Notes who learns; the losses are not known yet and stay nan."""
        self._stack.learn_later(self._rows, learning)
        return np.full(len(learning), np.nan, np.float32)

    def copy_to_target(self, agent: int) -> None:
        """Notes that an agent's target follows."""
        self._stack.copy_later(self._rows.start + agent)

    def choose(self, observations: FloatArray, choices: NDArray[np.int32]) -> None:
        """Notes what is to be chosen; the choices stand there once the stack has caught up."""
        self._stack.choose_later(self._rows, observations, choices)
