"""What does not move in a picture of an episode, as JSON for a page."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from env.rendering.drawing import best_gain_db
from env.scenario import Scenario

COLOURS = (
    "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#f0e442", "#444444",
)  # fmt: skip
"""Of robots in turn, told apart by the colour-blind.

Okabe and Ito (2008), "Color Universal Design".
"""

NO_WAY = 0
"""Of a map's bytes: a cell that no robot reaches; others are shades from 1 (dark) to 255."""


def scene(scenario: Scenario) -> dict[str, Any]:
    """The floor as a page draws it; lengths in m.

    Args:
        scenario: of the run.

    Returns:
        "size_m", "cell_m", "rows" and "columns"; "map", a byte for each cell in base64, row by row
        from y = 0, and "map_db", the gains of shades 1 and 255; "walls"; "ap" and "ris", which is
        None without one; "destinations" as cells; "power_w", P_max; "slot_s"; "oma", whether
        nobody decodes signals of others; and "colours".
    """
    config, floor = scenario.config, scenario.floor
    shades, range_db = _shades(np.where(floor.drivable(), best_gain_db(scenario.radio_map), np.nan))
    ris = config.ris.position_m[:2] if config.ris.side else None
    return {
        "size_m": [*map(float, floor.size_m)],
        "cell_m": config.room.cell_m,
        "rows": floor.rows,
        "columns": floor.columns,
        "map": base64.b64encode(shades.tobytes()).decode("ascii"),
        "map_db": range_db,
        "walls": [[*map(float, wall)] for wall in floor.walls],
        "ap": [*map(float, config.ap.position_m[:2])],
        "ris": None if ris is None else [*map(float, ris)],
        "destinations": scenario.destinations.tolist(),
        "power_w": 10.0 ** ((config.power.max_dbm - 30.0) / 10.0),
        "slot_s": scenario.slot_s,
        "oma": config.access == "oma",
        "colours": COLOURS,
    }


def _shades(gain_db: NDArray[np.float64]) -> tuple[NDArray[np.uint8], list[float]]:
    """Gains in dB, nan where there is no way, as bytes; and the gains at both ends of the scale."""
    low, high = (float(q) for q in np.nanpercentile(gain_db, (2, 98)))
    shade = 1.0 + 254.0 * np.clip((gain_db - low) / max(high - low, 1e-9), 0.0, 1.0)
    whole = np.where(np.isnan(gain_db), NO_WAY, np.round(np.nan_to_num(shade)))
    return whole.astype(np.uint8), [round(low, 1), round(high, 1)]
