"""Starts that whoever resets a view asks for, checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from env.arrays import Ints
from env.geometry.floor import UNREACHABLE
from env.world import World

TEST_OPTION = "options"
"""Means nothing: PettingZoo's own test of environments gives it to each of them."""


def starts_asked(options: Mapping[str, Any] | None) -> Any:
    """``starts_m`` of a reset's options, None without.

    Raises:
        ValueError: another option.
    """
    if options is not None and not isinstance(options, Mapping):
        raise ValueError(f"options={options!r}: allowed is a mapping with starts_m, or None")
    for name, value in (options or {}).items():
        if name not in ("starts_m", TEST_OPTION):
            raise ValueError(f"options.{name}={value!r}: allowed is the option starts_m alone")
    return (options or {}).get("starts_m")


def start_cells(world: World, starts_m: Any) -> Ints:
    """The cells of starts, positions in m that should be numbers of shape (K, 2); shape (K,).

    Raises:
        ValueError: no robot, or not all of them, can start there.
    """
    shown = starts_m.tolist() if isinstance(starts_m, np.ndarray) else starts_m
    key, allowed = f"options.starts_m={shown!r}", f"{world.robots} positions [x, y] in m"
    try:
        position = np.asarray(starts_m, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{key}: allowed is {allowed}") from error
    if position.shape != (world.robots, 2) or not np.isfinite(position).all():
        raise ValueError(f"{key}: allowed is {allowed}")
    if (position < 0).any() or (position >= world.floor.size_m).any():
        raise ValueError(f"{key}: allowed is inside the room")
    cell = world.floor.cell_at(position)
    if (cell == world.destinations).any():
        raise ValueError(f"{key}: allowed is off the destination")
    cut_off = world.slots_to_go[cell, np.arange(len(cell))] == UNREACHABLE
    if cut_off.any():
        raise ValueError(f"{key}: allowed is with a way to drive")
    if world.config.collisions == "block" and len({*cell.tolist()}) < len(cell):
        raise ValueError(f"{key}: allowed is in cells of their own")
    return cell
