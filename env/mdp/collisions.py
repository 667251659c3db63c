"""Robots that do not share cells: who may move where, ``env.collisions=block``."""

from __future__ import annotations

import numpy as np

from env.arrays import Bools, Ints


def moves_without_collisions(cell: Ints, wanted: Ints, driving: Bools, destinations: Ints) -> Ints:
    """The cells of robots after a slot in which none enters a cell that another one holds.

    Robots move in the order of their index: each sees where those before it are now and where
    those after it still are. Only robots that drive hold cells: one that reaches its destination
    has left the floor at once, so two robots cannot swap, and a row can move up from the front.

    Args:
        cell: where robots are, shape (B, K).
        wanted: the cell that each one's move leads to, shape (B, K); read where driving.
        driving: which robots are driving, shape (B, K).
        destinations: the cell that each robot is going to, shape (K,).
    """
    at, holds = cell.copy(), driving.copy()
    for k in range(cell.shape[1]):
        held = (at == wanted[:, k, None]) & holds
        held[:, k] = False
        at[:, k] = np.where(driving[:, k] & ~held.any(axis=-1), wanted[:, k], at[:, k])
        holds[:, k] &= at[:, k] != destinations[k]
    return at
