"""The distances by which rewards guide robots: straight, or along the way over the floor."""

from __future__ import annotations

import numpy as np

from env.arrays import Floats, Ints
from env.geometry.floor import Floor


def distance_m(position_m: Floats, destination_m: Floats) -> Floats:
    """d_{D,k}: the Euclidean distance to the destination in m, shape (...) of (..., 2)."""
    offset = destination_m - position_m
    return np.sqrt(offset[..., 0] * offset[..., 0] + offset[..., 1] * offset[..., 1])


def straight_m(floor: Floor, destinations: Ints) -> Floats:
    """Euclidean distances of all cells to each destination in m, shape (cells, n) for (n,)."""
    centres = floor.centres()
    return distance_m(centres[:, None], centres[destinations])


def distances_m(floor: Floor, destinations: Ints, along: str) -> Floats:
    """d_{D,k} of Eq. (11) in m from every cell to n destinations, shape (cells, n).

    ``along`` is ``env.reward.distance``: ``straight``, the paper's Euclidean distance; ``way``, the
    shortest length over the floor, which does not lead into dead ends behind solid walls; ``auto``,
    the way where walls are solid, the straight distance elsewhere.
    """
    if along == "way" or (along == "auto" and floor.solid):
        return np.asarray(floor.slots_to(destinations) * floor.cell_m)
    return straight_m(floor, destinations)
