"""What the gradient steps of a tick cost: one DQN over all joint actions, against F-DRL's agents.

Measured on the spot, with agents that learn from random transitions: a network with 55,296 outputs
(K = 3) takes tens of ms a step, so no training is needed to say what it costs. Above that none is
made, and its cost follows from the number of joint actions.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence

import numpy as np

from agent import DQN, single_threaded
from conf import Config, ap_network, joint_actions, robot_network
from experiments.reproduce.results.statistics import Floats

MEASURED = (2, 3)
EXTRAPOLATED = (4, 5, 6)
BLOCKS = 5
CENTRAL_STEPS, FEDERATED_STEPS = 4, 40
"""Gradient steps in a block."""


def actions(config: Config, robots: int) -> int:
    """Joint actions of a task with another number of robots, N_R^N (4 N_P)^K."""
    return joint_actions(_with(config, robots))


def ratios(ours: Config, theirs: Config) -> dict[int, Floats]:
    """Processor time of centralized DQN's gradient step over that of all of F-DRL's agents.

    Args:
        ours: F-DRL's configuration, with any K.
        theirs: centralized DQN's.

    Returns:
        From K to a ratio for each block of steps, shape (BLOCKS,). Above the largest K of
        ``MEASURED`` the centralized step is that K's, times the ratio of the joint actions.
    """
    single_threaded()
    every, last = (*MEASURED, *EXTRAPOLATED), MEASURED[-1]
    federated = {k: _federated(_with(ours, k)) for k in every}
    central = {k: [_access_point(_with(theirs, k), joint=True)] for k in MEASURED}
    ours_s: dict[int, list[float]] = {k: [] for k in every}
    theirs_s: dict[int, list[float]] = {k: [] for k in MEASURED}
    for _ in range(BLOCKS):  # in turns, so that what else the machine does meets all alike
        for k in every:
            ours_s[k].append(_step_s(federated[k], FEDERATED_STEPS))
        for k in MEASURED:
            theirs_s[k].append(_step_s(central[k], CENTRAL_STEPS))
    growth = {k: actions(ours, k) / actions(ours, min(k, last)) for k in every}
    return {k: np.array(theirs_s[min(k, last)]) * growth[k] / np.array(ours_s[k]) for k in every}


def _with(config: Config, robots: int) -> Config:
    return dataclasses.replace(config, env=dataclasses.replace(config.env, robots=robots))


def _federated(config: Config) -> list[DQN]:
    """Robots in one stack, and the access point."""
    agent = config.agent
    generators = [np.random.default_rng(robot) for robot in range(config.env.robots)]
    robots = DQN(robot_network(config), agent, agent.discount.robot, generators)
    return [_filled(robots, config), _access_point(config)]


def _access_point(config: Config, *, joint: bool = False) -> DQN:
    """The access point's agent, which may be the only one, over all joint actions (Baseline 1)."""
    discount = config.agent.discount.robot if joint else config.agent.discount.ap
    generators = [np.random.default_rng(0)]
    return _filled(DQN(ap_network(config), config.agent, discount, generators), config)


def _filled(agents: DQN, config: Config) -> DQN:
    """Agents with drawn weights that learn from every further transition."""
    agents.load(agents.shape.initial_pair(np.random.default_rng(1)))
    for _ in range(config.agent.learn_from):
        _learn(agents)
    return agents


def _learn(agents: DQN) -> None:
    """Stores a transition of each agent, and takes a gradient step once they hold enough."""
    count, generator = len(agents), np.random.default_rng(2)
    states = generator.standard_normal((2, count, agents.shape.inputs), np.float32)
    actions = generator.integers(agents.shape.actions, size=count)
    no, yes = np.zeros(count, bool), np.ones(count, bool)
    agents.learn(states[0], actions, np.zeros(count), states[1], no, yes)


def _step_s(learners: Sequence[DQN], steps: int) -> float:
    """Processor time of a gradient step of all agents, in s."""
    began = time.process_time()
    for _ in range(steps):
        for agents in learners:
            _learn(agents)
    return (time.process_time() - began) / steps
