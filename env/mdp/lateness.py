"""Starts that are too far to arrive from: no robot drives more cells than T_max has slots."""

from __future__ import annotations

import numpy as np

from env.arrays import Floats, Ints
from env.config import EnvConfig
from env.geometry.floor import UNREACHABLE, Floor
from env.mdp import starts
from env.validate import Problem

KEY = "env.motion.max_slots"


def late_share(config: EnvConfig, destinations: Ints) -> float:
    """The share of starts from which a robot cannot arrive, however it drives; see ``late_shares``.

    An episode's robots are late that often at least, whatever they learn.
    """
    return float(late_shares(config, destinations).mean())


def late_shares(config: EnvConfig, destinations: Ints) -> Floats:
    """The share of each robot's starts from which its shortest way takes more than T_max slots.

    Of the cells that the robot may start from, so 0 or 1 with ``tasks.start=fixed``; shape (K,), as
    the destinations. Ways go round solid walls; those of other robots are not looked at, so with
    ``collisions=block`` more may be late.
    """
    most = config.motion.max_slots
    return np.array([(slots > most).mean() for slots in _ways(config, destinations, most)])


def problems(config: EnvConfig, destinations: Ints) -> list[Problem]:
    """Whether some robot has no start from which it can arrive; arguments as ``late_shares``."""
    most = config.motion.max_slots
    if all((slots <= most).any() for slots in _ways(config, destinations, most)):
        return []
    nearest = np.array([slots.min() for slots in _ways(config, destinations)])
    robot = int(nearest.argmax())
    at_least = f"at least {nearest[robot]}, since robot_{robot}"
    if config.tasks.start == "fixed":
        say = f"{at_least} starts that many slots from its destination"
    else:
        say = (
            f"{at_least} has no nearer start with"
            f" env.tasks.start_distance_m={config.tasks.start_distance_m:g}"
        )
    return [(KEY, most, say)]


def given_problems(config: EnvConfig) -> list[Problem]:
    """As ``problems``, where all destinations are given: drawn ones are known with their seed."""
    tasks = config.tasks
    number = 1 if tasks.destination == "common" else config.robots
    if tasks.destination == "random" or len(tasks.destinations_m) < number:
        return []
    cells = Floor.from_config(config).cell_at(np.array(tasks.destinations_m[:number]))
    return problems(config, np.full(config.robots, cells))


def _ways(config: EnvConfig, destinations: Ints, most: int = UNREACHABLE) -> list[Ints]:
    """Fewest slots to arrive from each cell that a robot may start from, K arrays.

    Those above ``most`` may be ``UNREACHABLE``.
    """
    floor = Floor.from_config(config)
    goals, which = np.unique(destinations, return_inverse=True)
    slots = floor.slots_to(goals, most)
    back = (floor.neighbours()[goals] == goals[:, None]).any(axis=-1)
    slots[goals, np.arange(len(goals))] = np.where(back, 1, 2)  # one arrives by a move
    fixed = starts.fixed_starts(config, floor)
    if len(fixed):
        return list(slots[fixed, which][:, None])
    cells = starts.allowed_cells(config, floor, goals)
    ways = [column[some] for column, some in zip(slots.T, cells, strict=True)]
    return [ways[goal] for goal in which]
