"""Exploration: the epsilon schedule and the random part of an epsilon-greedy choice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.config import EpsilonConfig

NO_ACTION = -1
GREEDY = -2


def epsilon_at(config: EpsilonConfig, tick: int) -> float:
    """Share of random actions, falling linearly and then constant.

    Args:
        config: start, end and length of the fall.
        tick: tick of the whole run, from 0.

    Returns:
        Epsilon at that tick.
    """
    share = min(max(tick, 0) / config.ticks, 1.0)
    return config.start + share * (config.end - config.start)


def explore(
    generators: Sequence[np.random.Generator],
    epsilon: float,
    actions: int,
    active: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """Decides who acts at random and how.

    An active agent draws one number, and a second one if it explores; an idle agent draws none.
    So an agent's stream does not depend on who stands beside it.

    Args:
        generators: each agent's own, n of them.
        epsilon: probability of a random action.
        actions: number of actions.
        active: who acts, shape (n,).

    Returns:
        A random action, `GREEDY` or, for idle agents, `NO_ACTION`, shape (n,).
    """
    choices = [NO_ACTION] * len(generators)
    for agent, acts in enumerate(active.tolist()):
        if acts:
            generator = generators[agent]
            explores = generator.random() < epsilon
            choices[agent] = int(generator.random() * actions) if explores else GREEDY
    return np.array(choices, np.int32)
