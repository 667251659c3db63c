"""What agents that learn from replay have in common: weights, replays, streams, and their state.

How they choose, and what a transition holds, is the subclasses' (`agent.agents.dqn`,
`agent.agents.branching`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from agent.config import AgentConfig
from agent.learning.learner import Learner
from agent.networks.mlp import FloatArray, NetworkShape
from agent.replay import Replay
from storage.generators import generator_state, restore_generator

State = dict[str, NDArray[np.generic]]


class ReplayAgents:
    """n independent agents of one shape, each with a replay and a random stream of its own.

    Attributes:
        shape: of each agent's network.
        worlds: E, in each of which every agent acts.
        online: the online networks, shape (n, P), a view of the learner's memory.
        target: the target networks, likewise.
    """

    def __init__(
        self,
        shape: NetworkShape,
        config: AgentConfig,
        learner: Learner,
        generators: Sequence[np.random.Generator],
        worlds: int = 1,
    ) -> None:
        """Makes agents with weights of zero, each with a generator; `load` gives them others."""
        self.shape, self._config, self._learner = shape, config, learner
        self.worlds = worlds
        self._generators = list(generators)
        width = learner.batch.shape[-1]
        self._replays = [Replay(config.replay_size, width) for _ in generators]
        self._rows: FloatArray = np.zeros((len(self) * worlds, width), np.float32)
        self.online: FloatArray = learner.weights[:, 0]
        self.target: FloatArray = learner.weights[:, 1]

    def __len__(self) -> int:
        """The number of agents, n."""
        return len(self._generators)

    def load(self, weights: FloatArray) -> None:
        """Takes networks, as after an aggregation; they become FedProx's anchor too.

        Args:
            weights: online and target, shape (2, P) for all or (n, 2, P).
        """
        each = self._learner.weights.shape
        if weights.shape not in (each[1:], each):
            raise ValueError(f"weights have shape {weights.shape}, not {each[1:]} or {each}")
        self._learner.weights[:] = weights
        self._learner.proximal_reference[:] = self.online

    def weights(self) -> FloatArray:
        """A copy of the online and target networks, shape (n, 2, P)."""
        return self._learner.weights.copy()

    def _take_rows(self, active: NDArray[np.bool_]) -> FloatArray:
        """Stores the active agents' rows and lets those learn that hold enough.

        Args:
            active: which of the rows count, those of one agent's worlds side by side, shape (n E,).

        Returns:
            Mean losses, nan where no update was made, shape (n,).
        """
        where = active.reshape(len(self), self.worlds)
        stored: list[int] = np.add.reduce(where, axis=1, dtype=int).tolist()
        learning = []
        for agent, (replay, count) in enumerate(zip(self._replays, stored, strict=True)):
            if count and self.worlds == 1:
                replay.add(self._rows[agent])
            elif count:
                first = agent * self.worlds
                replay.extend(self._rows[first : first + self.worlds][where[agent]])
            learning.append(count > 0 and len(replay) >= self._config.learn_from)
        losses = self._update(learning)
        for _ in range(self._config.updates - 1):
            losses += self._update(learning)
        losses /= self._config.updates
        if self._config.target.tau is None:
            for agent, replay in enumerate(self._replays):
                if replay.added % self._config.target.every < stored[agent]:
                    self._learner.copy_to_target(agent)
        return losses

    def _update(self, learning: Sequence[bool]) -> FloatArray:
        """Lets agents take one gradient step each, on transitions drawn anew; mean losses."""
        for agent, learns in enumerate(learning):
            if learns:
                self._replays[agent].sample(self._generators[agent], self._learner.batch[agent])
        return self._learner.update(learning)

    def _saved_rows(self, agent: int) -> dict[str, FloatArray]:
        """Views of one agent's rows in the learner, by the names in its state."""
        learner = self._learner
        return {
            "weights": learner.weights[agent],
            "moments": learner.moments[agent],
            "anchor": learner.proximal_reference[agent],
        }

    def agent_state(self, agent: int) -> State:
        """All that one agent needs to go on to the same bits, in this stack or another.

        Args:
            agent: its place in the stack.

        Returns:
            Copies, by name.
        """
        replay = self._replays[agent]
        return {
            **{name: rows.copy() for name, rows in self._saved_rows(agent).items()},
            "updates": self._learner.steps[agent].astype(np.int64).reshape(1),
            "replay": replay.rows(),
            "stored": np.array([replay.added], np.int64),
            "generator": generator_state(self._generators[agent]),
        }

    def restore_agent(self, agent: int, state: Mapping[str, NDArray[np.generic]]) -> None:
        """Takes back what `agent_state` gave; a wrong shape is a ValueError.

        Args:
            agent: its place in this stack.
            state: from an agent of the same shape and configuration.
        """
        saved = self._saved_rows(agent)
        for name, rows in saved.items():
            if state[name].shape != rows.shape:
                raise ValueError(
                    f"{name} of shape {state[name].shape} do not fit this network: {rows.shape}"
                )
        self._replays[agent].restore(state["replay"], int(state["stored"][0]))
        for name, rows in saved.items():
            rows[:] = state[name]
        self._learner.steps[agent] = state["updates"][0]
        restore_generator(self._generators[agent], state["generator"])

    def state(self) -> State:
        """The states of all agents, named ``0/weights``, ``0/moments`` and so on."""
        return {
            f"{agent}/{name}": array
            for agent in range(len(self))
            for name, array in self.agent_state(agent).items()
        }

    def restore(self, state: Mapping[str, NDArray[np.generic]]) -> None:
        """Takes back what `state` gave."""
        for agent in range(len(self)):
            own = f"{agent}/"
            self.restore_agent(
                agent, {key.removeprefix(own): a for key, a in state.items() if key.startswith(own)}
            )
