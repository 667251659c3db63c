"""Robots as the link knows them: handlers of messages with no loop of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from agent import DQN, epsilon_at
from client_app.input_checks import check_model, check_received, check_rewards
from conf import Config, robot_network
from env.local_env import LocalEnv
from env.scenario import Scenario
from env.seeding import Stream, stream
from lockstep import Expect, Flag, Payload, Step
from training.checkpoint import flat, part
from training.exchange.facts import plain
from training.exchange.outbox import outboxes

# As numbers: NumPy looks for attributes on an enum's member, which runs Python code whose errors
# it drops, a KeyboardInterrupt among them.
OUTCOME, ARRIVED, DRIVING = int(Flag.OUTCOME), int(Flag.ARRIVED), int(Flag.DRIVING)


class RobotGroup:
    """n robots, each a DQN with its own local environments, stacked in one learner.

    A handler of messages: a step with results makes the robots learn and returns their next
    actions, ``upload`` returns their weights, ``download`` sets them. How robots are grouped
    changes no bit of any of them.

    Attributes:
        robots: which robots these are, indices below K.
        run: the run's identity, None where it has none.
        agents: their DQNs.
        parameters: P, of one network.
        window: the window of the last step.
    """

    def __init__(self, config: Config, robots: Sequence[int]) -> None:
        self.robots, self.run = tuple(robots), config.run.id
        self._epsilon = config.agent.epsilon
        rows = len(robots) * config.train.worlds
        self._rows = tuple(robot for robot in robots for _ in range(config.train.worlds))
        own = Scenario.drawn(config.env, config.seed).of(robots)
        self._slice = LocalEnv(own, config.train.worlds)
        self._seen = ("cell", "channel_db", "broadcast")[: 3 if self._slice.broadcast_size else 2]
        self._is_credited = own.rewards.weighs_credit
        self.agents = DQN(
            robot_network(config),
            config.agent,
            config.agent.discount.robot,
            [stream(config.seed, Stream.ROBOT, robot) for robot in robots],
            proximal_mu=config.strategy.proximal_mu,
            worlds=config.train.worlds,
        )
        self.parameters = self.agents.shape.parameters
        self._outboxes = outboxes(config, robots, self.parameters)
        self.window = 0
        self._cell = np.zeros(rows, dtype=np.int32)
        self._observation = np.zeros((rows, self._slice.observation_size), np.float32)
        self._action = np.zeros(rows, dtype=np.int32)

    def step(self, step: Step) -> NDArray[np.int32] | None:
        """Learns from the outcome that a step carries and answers the actions that it wants."""
        self.window = step.window
        updates = step.updates
        check_received(step.tick, self._rows, updates, self._slice.cells)
        flags = updates["flags"]
        learning = (flags & OUTCOME) != 0
        observation = self._observed(updates)
        if learning.any():
            self._learn(step.tick, updates, observation, learning, (flags & ARRIVED) != 0)
        self._cell, self._observation = updates["cell"], observation
        if step.expect is not Expect.ACTIONS:
            return None
        epsilon = epsilon_at(self._epsilon, step.tick)
        self._action = self.agents.act(self._observation, epsilon, (flags & DRIVING) != 0)
        return self._action

    def _learn(
        self,
        tick: int,
        updates: np.ndarray,
        observation: NDArray[np.float32],
        learning: NDArray[np.bool_],
        arrived: NDArray[np.bool_],
    ) -> None:
        """Learns from an outcome; it led to what is observed now, unless an episode has ended."""
        credit = updates["credit"] if self._is_credited else updates["rate"]
        reward = self._slice.reward(credit, self._cell, updates["outcome_cell"], arrived)
        check_rewards(tick, self._rows, reward, learning)
        if any((updates[part] != updates[f"outcome_{part}"]).any() for part in self._seen):
            observation = self._observed(updates, "outcome_")
        self.agents.learn(self._observation, self._action, reward, observation, arrived, learning)

    def _observed(self, updates: np.ndarray, of: str = "") -> NDArray[np.float32]:
        """s_L as the records have it of now, or of the ``outcome_``."""
        return self._slice.observe(*(updates[of + part] for part in self._seen))

    def upload(self) -> Payload:
        """What each robot sends: its online and target weights, float32, shape (n, 2, P).

        Options have it send something else, see ``training.exchange.outbox``.
        """
        weights = self.agents.weights()
        if not self._outboxes:
            return weights
        pairs = zip(self._outboxes, weights, strict=True)
        sent: Payload = np.stack([box.send(self.window, own) for box, own in pairs])
        return sent

    def download(self, window: int, weights: Payload) -> None:
        """Takes a window's global model, plain, shape (2, P), or packed, or (n, 2, P) own ones."""
        if self._outboxes:
            each = weights if weights.ndim == 3 else [weights] * len(self._outboxes)
            pairs = zip(self._outboxes, each, strict=True)
            weights = np.stack([box.take(given) for box, given in pairs])
        model = plain(weights)
        check_model(window, model)
        self.agents.load(model)

    def robot_state(self, index: int) -> dict[str, NDArray[np.generic]]:
        """All that the robot at a place among these needs to go on from the end of a window."""
        state = self.agents.agent_state(index)
        if self._outboxes:
            state |= flat({"outbox": self._outboxes[index].state()})
        return state

    def restore_robot(self, index: int, state: Mapping[str, NDArray[np.generic]]) -> None:
        """Takes back what ``robot_state`` gave; a wrong shape is a ValueError."""
        self.agents.restore_agent(index, state)
        if self._outboxes:
            self._outboxes[index].restore(part(state, "outbox"))
