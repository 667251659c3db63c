"""How robots are dealt to clients, and what a step tells them."""

from __future__ import annotations

import numpy as np

from conf import Config, robot_network, robots_learn
from env.mdp.observation import ObservationEncoder
from env.mdp.reward import RewardFunction
from lockstep.messages import Layout
from training.exchange.packing import packing

Block = tuple[int, ...]
"""The robots of one client."""


def step_layout(config: Config) -> Layout:
    """What a run's frames carry."""
    told = ObservationEncoder(config.env).broadcast_size
    credited = RewardFunction(config.env).weighs_credit
    up, down = (
        packing(config, robot_network(config).parameters) if robots_learn(config) else (None, None)
    )
    sizes = (0 if each is None else each.size for each in (up, down))
    return Layout(config.train.worlds, told, credited, *sizes)


def partition_robots(robots: int, clients: int) -> list[Block]:
    """Deals K robots to 1 to K clients in blocks of neighbours, as even as can be."""
    parts = np.array_split(np.arange(robots), clients)
    return [tuple(int(robot) for robot in part) for part in parts]
