"""Floors from a seed: rooms with doors, an AP and an RIS on the outer walls, destinations.

Walls lie at whole metres and so on the borders of cells; the AP and the RIS hang half a metre off
them, never at a wall's end.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from env.arrays import Floats, Ints
from env.config import MotionConfig, RoomConfig, TasksConfig
from env.geometry.floor import UNREACHABLE, Floor, line_of_sight
from env.seeding import Stream, stream

SIDE_M = (20, 30)
ROOMS = (3, 6)
ROOM_SIDE_M = 5
"""No room is narrower."""
DOOR_M = (2, 3)
DESTINATIONS = 4
HEIGHT_M = 2.0
MOUNTS = 16
"""Pairs of places for the AP and the RIS, of which the best one is taken."""

Point = tuple[int, int]


def random_plan(seed: int) -> dict[str, Any]:
    """A floor that depends on its seed alone: a value for each of ``floor_plans.KEYS``, nested.

    A rectangle is divided into rooms by solid walls, each with a door. ``max_slots`` is at least
    twice the longest way to a destination, which is enough for a way between any two cells.
    """
    draw, cell_m = stream(seed, Stream.FLOOR), RoomConfig().cell_m
    while True:
        width, depth = draw.integers(*SIDE_M, size=2, endpoint=True).tolist()
        walls = _divided(draw, width, depth)
        columns, rows = (round(side / cell_m) for side in (width, depth))
        floor = Floor(columns, rows, cell_m, np.array(walls), solid=True)
        goals = _destinations(draw, floor)
        longest = int(floor.slots_to(goals).max())
        if longest < UNREACHABLE:
            break
    ap_m, ris_m, axis = _mounts(draw, floor)
    motion = MotionConfig()
    return {
        "room": asdict(RoomConfig(float(width), float(depth), cell_m)),
        "walls": {"segments": walls, "block_motion": True},
        "ap": {"position_m": ap_m},
        "ris": {"position_m": ris_m, "axis": axis},
        "motion": {
            "antenna_height_m": motion.antenna_height_m,
            "max_slots": max(motion.max_slots, 2 * longest),
        },
        "tasks": asdict(TasksConfig(destinations_m=floor.centres()[goals].tolist())),
    }


def _divided(draw: np.random.Generator, width: int, depth: int) -> list[list[float]]:
    """The walls of a floor that is divided, the largest room first and across its longer side.

    No wall ends in a door. Where that leaves no place for one, there are fewer rooms; never fewer
    than three, since the larger half of a floor has places on both sides of a door.
    """
    rooms, walls = [((0, 0), (width, depth))], []
    in_doors: set[Point] = set()
    for _ in range(int(draw.integers(*ROOMS, endpoint=True)) - 1):
        low, high = room = max(rooms, key=_area)
        across = int(high[1] - low[1] > high[0] - low[0])
        along = 1 - across
        places = [
            at
            for at in range(low[across] + ROOM_SIDE_M, high[across] - ROOM_SIDE_M + 1)
            if in_doors.isdisjoint(_point(across, at, end[along]) for end in (low, high))
        ]
        if not places:
            break
        at, door = int(draw.choice(places)), int(draw.integers(*DOOR_M, endpoint=True))
        start = int(draw.integers(low[along] + 1, high[along] - 1 - door, endpoint=True))
        for first, last in ((low[along], start), (start + door, high[along])):
            ends = (_point(across, at, first), _point(across, at, last))
            walls.append([float(x) for end in ends for x in end])
        in_doors |= {_point(across, at, inside) for inside in range(start + 1, start + door)}
        rooms.remove(room)
        rooms.append((low, _point(across, at, high[along])))
        rooms.append((_point(across, at, low[along]), high))
    return walls


def _area(room: tuple[Point, Point]) -> int:
    (x0, y0), (x1, y1) = room
    return (x1 - x0) * (y1 - y0)


def _point(axis: int, here: int, there: int) -> Point:
    """The point with one coordinate on an axis and the other one on the other axis."""
    return (there, here) if axis else (here, there)


def _destinations(draw: np.random.Generator, floor: Floor) -> Ints:
    """Cells as far apart as drawn destinations are, shape (DESTINATIONS,)."""
    centres, left = floor.centres(), np.ones(floor.cells, dtype=bool)
    cells: list[int] = []
    while len(cells) < DESTINATIONS:
        cells.append(int(draw.choice(np.flatnonzero(left))))
        apart_m = np.linalg.norm(centres - centres[cells[-1]], axis=-1)
        left &= apart_m >= TasksConfig().destination_spacing_m
    return np.array(cells)


def _mounts(draw: np.random.Generator, floor: Floor) -> tuple[list[float], list[float], str]:
    """Where the AP and the RIS hang, on two outer walls, and the axis of the RIS.

    Of some pairs of places: the RIS that sees the AP, if one does, and most of the AP's shadow.
    """
    pairs = []
    for _ in range(MOUNTS):
        sides = draw.permutation(4)[:2].tolist()
        ap_m, ris_m = (_on_side(draw, floor, side) for side in sides)
        pairs.append((ap_m, ris_m, "y" if sides[1] < 2 else "x"))
    fed = [bool(line_of_sight(ap_m, ris_m[None], floor.walls)[0]) for ap_m, ris_m, _ in pairs]
    shadows = [
        _in_shadow(floor, ap_m, ris_m) if sees == any(fed) else -1
        for sees, (ap_m, ris_m, _) in zip(fed, pairs, strict=True)
    ]
    ap_m, ris_m, axis = pairs[int(np.argmax(shadows))]
    return [*ap_m.tolist(), HEIGHT_M], [*ris_m.tolist(), HEIGHT_M], axis


def _in_shadow(floor: Floor, ap_m: Floats, ris_m: Floats) -> int:
    """Cells that a RIS sees and an AP does not."""
    lit, reached = (line_of_sight(at, floor.centres(), floor.walls) for at in (ap_m, ris_m))
    return int((reached & ~lit).sum())


def _on_side(draw: np.random.Generator, floor: Floor, side: int) -> Floats:
    """A place on the wall x = 0, x = width, y = 0 or y = depth, shape (2,)."""
    place = draw.integers(floor.size_m.astype(np.int64)) + 0.5
    axis, far = divmod(side, 2)
    place[axis] = far * floor.size_m[axis]
    return np.asarray(place)
