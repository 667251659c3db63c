"""The temporal-difference target and the Huber loss, each with the paper it comes from."""

from __future__ import annotations

import numpy as np

from agent.networks.mlp import FloatArray


def dqn_values(target_q: FloatArray) -> FloatArray:
    """Value of the next state, max_a Q_target(s', a): Mnih et al., Nature 518 (2015).

    Shape (n, B) of the target network's values of s', shape (n, actions, B).
    """
    values: FloatArray = np.maximum.reduce(target_q, axis=1)
    return values


def double_dqn_values(online_q: FloatArray, target_q: FloatArray) -> FloatArray:
    """Value of the next state, Q_target(s', argmax_a Q_online(s', a)).

    van Hasselt, Guez and Silver, "Deep reinforcement learning with double Q-learning",
    AAAI 2016, Eq. (4). Shape (n, B) of both networks' values of s', shapes (n, actions, B).
    """
    best = np.argmax(online_q, axis=1)
    values: FloatArray = np.take_along_axis(target_q, best[:, None], axis=1)[:, 0]
    return values


def td_target(
    rewards: FloatArray, terminal: FloatArray, next_values: FloatArray, discount: float | FloatArray
) -> FloatArray:
    """Target r + discount (1 - terminal) V(s'): a terminal transition does not bootstrap.

    Args:
        rewards: shape (n, B), as the targets.
        terminal: 1 where the episode ended for good, else 0, shape (n, B).
        next_values: V(s'), shape (n, B).
        discount: at least 0 and below 1, or one of each n, shape (n, 1).
    """
    target = 1 - terminal
    target *= next_values
    target *= discount
    target += rewards
    return target


def huber(error: FloatArray, delta: float) -> tuple[FloatArray, FloatArray]:
    """Huber's loss and its slope, Annals of Mathematical Statistics 35 (1964).

    With c = clip(e, -delta, delta) the loss is c (e - c/2), and c is its derivative.

    Args:
        error: e = Q(s, a) - y, shape (n, B).
        delta: where the parabola turns into a line.

    Returns:
        The loss of each sample and its derivative by the error, both of shape (n, B).
    """
    grad: FloatArray = np.minimum(np.maximum(error, -delta), delta)
    loss: FloatArray = grad * np.float32(-0.5)
    loss += error
    loss *= grad
    return loss, grad
