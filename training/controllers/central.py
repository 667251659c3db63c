"""One agent for everything: it sets the phases, and the robots do what it says.

It is the coordinator's access point, and the fleet is a row of robots without networks (their
weights have P = 0) that wait for its orders. So the order of a tick, the measures, the checkpoints
and the bits of the world are those of F-DRL.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent import DQN, NO_ACTION, BranchingDQN, epsilon_at
from conf import Config, central_heads, robot_actions
from env.world import StepResult
from lockstep import Expect, Flag
from training.controllers.access_point import NetworkAgent
from training.controllers.service import Actions, States

DRIVING = np.uint16(Flag.DRIVING)
_Value = TypeVar("_Value", bound=np.generic)


class CommandedFleet:
    """A ``Fleet`` of robots without networks, which follow the one agent's orders.

    Attributes:
        driving: which robots are driving, shape (E, K).
        orders: their next actions, int32, shape (E, K), -1 where one is not driving.
    """

    def __init__(self, robots: int, worlds: int) -> None:
        self.driving = np.zeros((worlds, robots), dtype=bool)
        self.orders = np.full((worlds, robots), NO_ACTION, np.int32)

    def send_step(self, tick: int, window: int, expect: Expect, updates: np.ndarray) -> None:
        """See ``Fleet.send_step``."""
        driving = (updates["flags"] & DRIVING) != 0
        self.driving = driving.reshape(-1, len(self.orders)).T

    def actions(self, tick: int) -> NDArray[np.int32]:
        """See ``Fleet.actions``."""
        return self.orders.T.ravel()

    def upload(self, window: int) -> NDArray[np.float32]:
        """See ``Fleet.upload``: robots without weights."""
        return np.zeros((self.orders.shape[1], 2, 0), np.float32)

    def download(self, window: int, weights: NDArray[np.float32]) -> None:
        """See ``Fleet.download``: there is no global model."""

    def begin(self, window: int, model: NDArray[np.float32] | None) -> None:
        """See ``Fleet.begin``: the robots hold nothing that they would have to go back to."""

    def close(self) -> None:
        """See ``Fleet.close``."""


class CentralAgent(NetworkAgent):
    """A ``RisController`` that commands the robots, too: its ``fleet``."""

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.fleet = CommandedFleet(config.env.robots, config.train.worlds)

    @abstractmethod
    def _decide(self, state: States, epsilon: float) -> tuple[Actions, Actions]:
        """Its own actions, (E,), and those of the robots, (E, K), of any value if not driving."""

    def act(self, state: States, tick: int) -> Actions:
        """See ``RisController.act``: decides for the robots, too."""
        action, orders = self._decide(state, epsilon_at(self._epsilon, tick))
        self.fleet.orders = np.where(self.fleet.driving, orders, NO_ACTION).astype(np.int32)
        return action


class JointAgent(CentralAgent):
    """Baseline 1: one DQN over the joint actions, N_R^N (4 N_P)^K where robots pick powers.

    Its reward is sum_k r_{L,k} + r_G / 10. The part of a robot that has arrived has no effect.
    """

    agent: DQN

    def _new_agent(self, generator: np.random.Generator) -> DQN:
        return self._new_dqn(self._config.agent.discount.robot, generator)

    def _decide(self, state: States, epsilon: float) -> tuple[Actions, Actions]:
        self._joint = self.agent.act(state, epsilon, self._always)
        space, robots = robot_actions(self._config), self._config.env.robots
        return space.joint_decode(self._joint.astype(np.int64), robots)

    def learn(self, state: States, action: Actions, outcome: StepResult, seen: States) -> None:
        """See ``RisController.learn``."""
        reward, ended = joint_reward(outcome, self._config.scheme.global_share), outcome.terminated
        self.agent.learn(state, self._joint, reward, seen, ended, self._always)


class BranchingAgent(CentralAgent):
    """One network with a head for the RIS and one for each robot.

    With ``scheme.heads=own`` each head learns what the agent in whose place it stands would: the
    RIS's from r_G, a robot's from its r_L. With ``shared`` all learn from Baseline 1's reward. The
    head of a robot that has arrived decides and learns nothing.
    """

    agent: BranchingDQN

    def _new_agent(self, generator: np.random.Generator) -> BranchingDQN:
        heads, worlds = central_heads(self._config), self._config.train.worlds
        return BranchingDQN(self.shape, heads, self._config.agent, generator, worlds)

    def _decide(self, state: States, epsilon: float) -> tuple[Actions, Actions]:
        self._parts = self.agent.choose(state, epsilon, _with_own(True, self.fleet.driving))
        parts = self._parts.astype(np.int64)
        return parts[:, 0], parts[:, 1:]

    def learn(self, state: States, action: Actions, outcome: StepResult, seen: States) -> None:
        """See ``RisController.learn``."""
        rewards = _with_own(outcome.global_reward, outcome.local_reward)
        if self.agent.heads.shared:
            rewards[:] = joint_reward(outcome, self._config.scheme.global_share)[:, None]
        active = _with_own(True, outcome.drove)
        ended = _with_own(outcome.terminated, outcome.arrived)
        self.agent.learn(state, self._parts, rewards, seen, ended, active)


def _with_own(own: ArrayLike, robots: NDArray[_Value]) -> NDArray[_Value]:
    """The RIS's value, (E,), before those of the robots, (E, K): shape (E, 1 + K)."""
    each = np.empty((len(robots), 1 + robots.shape[1]), robots.dtype)
    each[:, 0], each[:, 1:] = own, robots
    return each


def joint_reward(outcome: StepResult, global_share: float) -> NDArray[np.float64]:
    """Baseline 1's reward, sum_k r_{L,k} + r_G / 10, of B worlds, shape (B,).

    ``global_share`` stands for the paper's 1 / 10.
    """
    return np.asarray(outcome.local_reward.sum(axis=-1) + global_share * outcome.global_reward)
