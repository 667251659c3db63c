"""Exploration: the epsilon schedule and the random part of an epsilon-greedy choice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.config import EpsilonConfig

NO_ACTION = -1
GREEDY = -2


def epsilon_at(config: EpsilonConfig, tick: int) -> float:
    """Share of random actions at a tick of the run, from 0: falling linearly and then constant."""
    share = min(max(tick, 0) / config.ticks, 1.0)
    return config.start + share * (config.end - config.start)


def explore(
    generators: Sequence[np.random.Generator],
    epsilon: float,
    actions: int,
    active: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """Decides who acts at random and how.

    An agent draws a number for each world in which it acts, and then one for each in which it
    explores; where it is idle it draws none. So its stream does not depend on who stands beside it.

    Args:
        generators: each agent's own, n of them.
        epsilon: probability of a random action.
        actions: number of actions.
        active: who acts in which world, shape (n, E).

    Returns:
        A random action, `GREEDY` or, where idle, `NO_ACTION`, shape (n, E).
    """
    if active.shape[-1] > 1:
        return _explore_in_worlds(generators, epsilon, actions, active)
    choices = [NO_ACTION] * len(generators)
    for agent, acts in enumerate(active[:, 0].tolist()):
        if acts:
            generator = generators[agent]
            explores = generator.random() < epsilon
            choices[agent] = int(generator.random() * actions) if explores else GREEDY
    return np.array(choices, np.int32)[:, None]


def _explore_in_worlds(
    generators: Sequence[np.random.Generator],
    epsilon: float,
    actions: int,
    active: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """As ``explore``, for many worlds at once."""
    choices = np.full(active.shape, NO_ACTION, np.int32)
    for generator, own, acts in zip(generators, choices, active, strict=True):
        places = np.flatnonzero(acts)
        explores = generator.random(len(places)) < epsilon
        drawn = generator.random(int(np.count_nonzero(explores))) * actions
        own[places] = GREEDY
        own[places[explores]] = drawn.astype(np.int32)
    return choices
