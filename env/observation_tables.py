"""Observations that depend on a robot and its cell alone, computed once for every cell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from env.arrays import Floats32
from env.scenario import Scenario

MAX_SEEN = 2**20
"""Most cells times robots for which observations are tabulated: 54 MB, 75 MB with ways."""


class ObservationTables(NamedTuple):
    """What is seen from every cell.

    Attributes:
        local: s_L without what the AP tells, shape (cells, K, size).
        by_ap: what the AP sees of a robot while it drives, shape (cells, K, size).
    """

    local: Floats32
    by_ap: Floats32

    @classmethod
    def of(cls, scenario: Scenario) -> ObservationTables | None:
        """The tables of a scenario; None where channels change by the slot or it is large."""
        cells, robots = scenario.distance_m.shape
        if scenario.config.channel.fading == "slot" or cells * robots > MAX_SEEN:
            return None
        cell = np.broadcast_to(np.arange(cells)[:, None], (cells, robots))
        radio_map, everywhere = scenario.radio_map, np.ones((cells, robots), dtype=bool)
        local = scenario.local_states(cell, radio_map.direct_db[cell])
        return cls(local, scenario.observer.seen_robots(local, radio_map.direct[cell], everywhere))
