"""What the access point and the RIS see from where they hang, and where neither may hang.

A wall has no thickness, so a device on it needs a rule for the side that it looks to: on the room's
edge all links lie on one side, and past a wall's end a link leaves the wall where it starts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from env.arrays import Bools, Floats
from env.config import EnvConfig
from env.geometry.floor import Floor, line_of_sight
from env.validate import Problem

TOUCH_M = 1e-9
"""What is no farther than that from a wall, or from the room's edge, lies on it."""


def sees(floor: Floor, device_m: Sequence[float] | Floats, points_m: Floats) -> Bools:
    """Which points are in line of sight of an AP or RIS.

    A link is blocked by a wall that it touches, its far end included. There are two exceptions: a
    wall along the room's edge blocks nothing, and one that ends at the device blocks only links
    that run along it.

    Args:
        floor: with the walls.
        device_m: where the device hangs, at least x and y in m.
        points_m: the other ends of its links, shape (P, 2).

    Returns:
        Whether a link is in line of sight, shape (P,).
    """
    device, walls = np.asarray(device_m, dtype=np.float64)[:2], inner_walls(floor)
    seen = line_of_sight(device, points_m, walls[~_ending_at(walls, device)])
    return np.asarray(seen & ~_leaves_along(walls, device, points_m))


def see_each_other(floor: Floor, first_m: Sequence[float], second_m: Sequence[float]) -> Bools:
    """Whether two devices are in line of sight; ``sees``, with both ends hanging; shape (1,)."""
    first, second = (np.asarray(place, dtype=np.float64)[:2] for place in (first_m, second_m))
    walls = inner_walls(floor)
    others = replace(floor, walls=walls[~_ending_at(walls, second)])
    seen = sees(others, first, second[None])
    return np.asarray(seen & ~_leaves_along(walls, second, first[None]))


def inner_walls(floor: Floor) -> Floats:
    """The walls but those along the room's edge, which have nothing behind them, shape (W, 4)."""
    ends, size_m = floor.walls.reshape(-1, 2, 2), floor.size_m
    along = [np.abs(ends - side).max(axis=1) <= TOUCH_M for side in (np.zeros(2), size_m)]
    return np.asarray(floor.walls[~np.logical_or(*along).any(axis=-1)])


def problems(config: EnvConfig) -> Iterator[Problem]:
    """Whether the AP or the RIS is inside a wall, where it would see nothing."""
    walls = inner_walls(Floor.from_config(config))
    devices = [("env.ap.position_m", config.ap.position_m)]
    if config.ris.side:
        devices.append(("env.ris.position_m", config.ris.position_m))
    for key, position in devices:
        inside = _holding(walls, np.asarray(position[:2], dtype=np.float64))
        if len(inside):
            say = "a place off the walls, at a wall's end or on the room's edge, and not inside"
            yield key, position, f"{say} {inside[0].tolist()} of env.walls.segments"


def _ending_at(walls: Floats, place_m: Floats) -> Bools:
    """Which walls have an end at a place, shape (W,)."""
    apart_m = np.linalg.norm(walls.reshape(-1, 2, 2) - place_m, axis=-1)
    return np.asarray((apart_m <= TOUCH_M).any(axis=-1))


def _far_ends(walls: Floats, place_m: Floats) -> Floats:
    """The other ends of the walls that end at a place, shape (n, 2)."""
    ends = walls[_ending_at(walls, place_m)].reshape(-1, 2, 2)
    far = np.linalg.norm(ends - place_m, axis=-1).argmax(axis=-1)
    return np.asarray(ends[np.arange(len(ends)), far])


def _leaves_along(walls: Floats, device_m: Floats, points_m: Floats) -> Bools:
    """Which links run along a wall that ends at the device, shape (P,)."""
    far_m = _far_ends(walls, device_m)
    ahead_m, aside_m = _offsets_m(device_m, far_m, points_m[:, None])
    return np.asarray(((ahead_m > TOUCH_M) & (aside_m <= TOUCH_M)).any(axis=-1))


def _holding(walls: Floats, place_m: Floats) -> Floats:
    """The walls with a place between their ends, shape (n, 4).

    A wall may be drawn in parts: two that end at the place count where they go straight on.
    """
    ahead_m, aside_m = _offsets_m(walls[:, :2], walls[:, 2:], place_m)
    length_m = np.linalg.norm(walls[:, 2:] - walls[:, :2], axis=-1)
    inside = (aside_m <= TOUCH_M) & (ahead_m > TOUCH_M) & (ahead_m < length_m - TOUCH_M)
    far_m = _far_ends(walls, place_m)
    ahead_m, aside_m = _offsets_m(place_m, far_m[:, None], far_m)
    straight_on = (ahead_m < -TOUCH_M) & (aside_m <= TOUCH_M)
    inside[_ending_at(walls, place_m)] = straight_on.any(axis=-1)
    return np.asarray(walls[inside])


def _offsets_m(start_m: Floats, stop_m: Floats, points_m: Floats) -> tuple[Floats, Floats]:
    """How far points lie ahead on the line start-stop, and how far beside it; broadcast, (...)."""
    line = stop_m - start_m
    line = line / np.linalg.norm(line, axis=-1, keepdims=True)
    to = points_m - start_m
    aside = line[..., 0] * to[..., 1] - line[..., 1] * to[..., 0]
    return (line * to).sum(axis=-1), np.abs(aside)
