"""Paths over the floor in a fixed number of slots: which there are, and which is worth most.

Functions of the table of moves, ``World.next_cell``: where a move leads is read, not computed. A
path ends when its destination is entered for the first time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from env.arrays import Bools, Floats, Ints

Path = Ints
"""The directions of a robot's moves, shape (T_k,)."""


def cells_along(after: Ints, start: int, path: Path) -> Ints:
    """The cells of a path, the first and the last included, shape (T_k + 1,)."""
    cells = [start]
    for direction in path:
        cells.append(int(after[cells[-1], direction]))
    return np.array(cells)


def free_moves(after: Ints, slots: int, others: Sequence[Ints]) -> Bools:
    """Which moves neither enter a cell that others hold or enter, nor hold one that they enter.

    So no move is blocked in ``World.step``, whoever moves first; a row that moves up, which that
    allows in one order of the robots, is left out.

    Args:
        after: the cell that each move leads to, shape (cells, 4), here and below.
        slots: T, how many slots to look at.
        others: the cells along the paths of the other robots, shape (T_j + 1,) each; a robot that
            has arrived holds no cell.

    Returns:
        Whether a move is free, shape (T, cells, 4).
    """
    free = np.ones((slots, *after.shape), dtype=bool)
    for path in others:
        for slot in range(min(slots, len(path) - 1)):
            here, there = path[slot], path[slot + 1]
            free[slot][(after == here) | (after == there)] = False
            free[slot, there] = False
    return free


def ways_to(after: Ints, goal: int, moves: Bools) -> Bools:
    """From where one first arrives at a goal after exactly the slots that are left.

    Args as of ``free_moves``, which gives ``moves``. A table of bool by slots gone and cell, shape
    (T + 1, cells).
    """
    slots = len(moves)
    ways = np.zeros((slots + 1, len(after)), dtype=bool)
    ways[slots, goal] = True
    for slot in reversed(range(slots)):
        ways[slot] = np.logical_or.reduce((moves[slot] & ways[slot + 1][after]).T)
        if slot:
            ways[slot, goal] = False
    return ways


def ways_from(after: Ints, start: int, goal: int, moves: Bools) -> Bools:
    """Where one can be after so many slots without having arrived; as ``ways_to``."""
    reached = np.zeros((len(moves) + 1, len(after)), dtype=bool)
    reached[0, start] = True
    for slot, allowed in enumerate(moves):
        reached[slot + 1, after[reached[slot][:, None] & allowed]] = True
        reached[slot + 1, goal] = False
    return reached


def best_way(
    after: Ints, start: int, stage: Floats, moves: Bools, ways: Bools
) -> tuple[float, Path]:
    """The path of T slots that collects most, by backward induction.

    Args:
        after: as of ``free_moves``, which gives ``moves``.
        start: the first cell.
        stage: what a slot in a cell brings, -inf where a path may not be, shape (T, cells).
        moves: of at least T slots.
        ways: ``ways_to`` of the destination.

    Returns:
        What the path collects, -inf where there is none, and its directions, ties going to the
        lowest direction.
    """
    slots = len(stage)
    value = np.where(ways[slots], 0.0, -np.inf)
    choice = np.zeros((slots, len(after)), dtype=np.int64)
    for slot in reversed(range(slots)):
        cells = np.flatnonzero(ways[slot] & (stage[slot] > -np.inf))  # few of all
        follow = np.where(moves[slot, cells], value[after[cells]], -np.inf)
        choice[slot, cells] = follow.argmax(axis=-1)
        value = np.full(len(after), -np.inf)
        value[cells] = stage[slot, cells] + follow.max(axis=-1)
    total, cell, path = float(value[start]), start, np.zeros(slots, dtype=np.int64)
    for slot in range(slots):
        path[slot] = choice[slot, cell]
        cell = int(after[cell, path[slot]])
    return total, path
