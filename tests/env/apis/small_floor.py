"""A floor of 320 cells, on which views and their tables are quickly made."""

from typing import Any

SMALL: dict[str, dict[str, Any]] = {
    "room": {"width_m": 10.0, "depth_m": 8.0},
    "walls": {"segments": [[0.0, 4.0, 6.0, 4.0]]},
    "ap": {"position_m": [5.0, 8.0, 2.0]},
    "ris": {"position_m": [10.0, 2.0, 2.0]},
    "tasks": {
        "destinations_m": [[8.25, 2.25], [1.25, 6.25], [6.25, 7.25]],
        "destination_spacing_m": 0.5,
        "start_distance_m": 2.0,
    },
}


def on_small_floor(config: dict[str, Any]) -> dict[str, Any]:
    """A configuration with that floor, unless it names a plan or a room of its own."""
    if "plan" in config or "room" in config:
        return config
    return {**config, **{name: {**SMALL[name], **config.get(name, {})} for name in SMALL}}
