"""Where robots start: fixed cells, or those that starts are drawn from."""

from __future__ import annotations

import numpy as np

from env.arrays import Ints
from env.config import EnvConfig
from env.geometry import distances
from env.geometry.floor import Floor


def fixed_starts(config: EnvConfig, floor: Floor) -> Ints:
    """The cells of ``tasks.starts_m``, shape (K,), or (0,) where starts are drawn."""
    if config.tasks.start == "random":
        return np.zeros(0, dtype=np.int64)
    return floor.cell_at(np.asarray(config.tasks.starts_m[: config.robots], dtype=np.float64))


def allowed_cells(config: EnvConfig, floor: Floor, destinations: Ints) -> list[Ints]:
    """The cells to start from with ``tasks.start=random``, rising, an array for each destination.

    They lie on the drivable floor, in a straight line at least ``tasks.start_distance_m`` from the
    destination.
    """
    far = distances.straight_m(floor, destinations) >= config.tasks.start_distance_m
    return [np.flatnonzero(column) for column in (far & floor.drivable()[:, None]).T]


def start_cells(config: EnvConfig, floor: Floor, destinations: Ints) -> list[Ints]:
    """As ``allowed_cells``, K arrays.

    Raises:
        ValueError: with ``collisions=block``, a robot has fewer of them than there are robots.
    """
    cells = allowed_cells(config, floor, destinations)
    wanted = config.collisions == "block" and config.tasks.start == "random"
    if wanted and min(map(len, cells)) < len(destinations):
        raise ValueError(f"no room for {len(destinations)} starts in cells of their own")
    return cells


def distinct_starts(allowed: list[Ints], count: int, generator: np.random.Generator) -> Ints:
    """Start cells that no two robots of a world share, shape (count, K).

    Robots draw one after the other, uniformly from the cells ``allowed``, at least K for each, and
    again as long as an earlier one has the cell.
    """
    starts = np.full((count, len(allowed)), -1)
    for k, cells in enumerate(allowed):
        again = np.arange(count)
        while len(again):
            starts[again, k] = generator.choice(cells, size=len(again))
            again = again[(starts[again, :k] == starts[again, k, None]).any(axis=-1)]
    return starts
