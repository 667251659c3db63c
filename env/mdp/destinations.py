"""Where the robots are going."""

from __future__ import annotations

import numpy as np

from env.arrays import Ints
from env.config import EnvConfig
from env.geometry.floor import Floor
from env.mdp import starts


def draw_destinations(config: EnvConfig, generator: np.random.Generator) -> Ints:
    """The destinations of K robots: given ones first, further ones drawn.

    ``tasks.destination`` is ``fixed``: those of ``tasks.destinations_m`` are given; ``random``:
    none are; ``common``: the first one, given or drawn, is everybody's.

    Returns:
        Cells, shape (K,), the drawn ones at least ``tasks.destination_spacing_m`` from all others,
        on the drivable floor, and none a cell of ``tasks.starts_m`` with ``tasks.start=fixed``.

    Raises:
        ValueError: the floor has no room for that many, or with ``collisions=block`` none for as
            many starts.
    """
    floor, tasks = Floor.from_config(config), config.tasks
    centres = floor.centres()
    count = 1 if tasks.destination == "common" else config.robots
    given = [] if tasks.destination == "random" else tasks.destinations_m[:count]
    chosen = [int(floor.cell_at(np.asarray(position))) for position in given]
    allowed = floor.drivable()
    allowed[starts.fixed_starts(config, floor)] = False
    while len(chosen) < count:
        apart = np.linalg.norm(centres[:, None] - centres[chosen], axis=-1).min(
            axis=-1, initial=np.inf
        )
        free = np.flatnonzero(allowed & (apart >= tasks.destination_spacing_m))
        if not len(free):
            raise ValueError(
                f"no room for {config.robots} destinations that are"
                f" env.tasks.destination_spacing_m={tasks.destination_spacing_m:g} m apart"
            )
        chosen.append(int(generator.choice(free)))
    destinations = np.full(config.robots, chosen)
    starts.start_cells(config, floor, destinations)
    return destinations
