"""The floor: cells, walls, moves, ways and lines of sight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from env.arrays import Bools, Floats, Ints
from env.config import EnvConfig

DIRECTIONS = ("n", "s", "e", "w")
STEPS = np.array([(0, 1), (0, -1), (1, 0), (-1, 0)])
"""Change of (column, row) for each direction, shape (4, 2)."""
UNREACHABLE = 1_000_000_000
"""Slots from a cell that no way leads from: more than any floor has cells."""


@dataclass(frozen=True)
class Floor:
    """A rectangular floor of square cells; cell ``c`` is column ``c % columns`` of its row.

    Attributes:
        columns: cells along x.
        rows: cells along y.
        cell_m: side of a cell, Delta_S.
        walls: segments, shape (W, 4), each x0, y0, x1, y1 in m.
        solid: whether walls stop robots, too.
    """

    columns: int
    rows: int
    cell_m: float
    walls: Floats
    solid: bool = False

    @classmethod
    def from_config(cls, config: EnvConfig) -> Floor:
        """The floor that a configuration describes."""
        room = config.room
        walls = np.asarray(config.walls.segments, dtype=np.float64).reshape(-1, 4)
        columns, rows = (round(side / room.cell_m) for side in (room.width_m, room.depth_m))
        return cls(columns, rows, room.cell_m, walls, config.walls.block_motion)

    @property
    def cells(self) -> int:
        """The number of cells."""
        return self.columns * self.rows

    @property
    def size_m(self) -> Floats:
        """Width and depth, shape (2,)."""
        return np.array([self.columns, self.rows], dtype=np.float64) * self.cell_m

    def centres(self) -> Floats:
        """The centre of each cell in m, shape (cells, 2)."""
        cell = np.arange(self.cells)
        place = np.stack([cell % self.columns, cell // self.columns], axis=-1)
        return np.asarray((place + 0.5) * self.cell_m)

    def cell_at(self, position_m: Floats) -> Ints:
        """The cell that holds a position x, y in m, shape (...) of (..., 2).

        Raises:
            ValueError: a position lies outside the room.
        """
        index = np.floor(np.asarray(position_m) / self.cell_m).astype(np.int64)
        if (index < 0).any() or (index >= (self.columns, self.rows)).any():
            at, (width_m, depth_m) = np.asarray(position_m).tolist(), self.size_m
            raise ValueError(f"{at} lies outside the room of {width_m:g} m x {depth_m:g} m")
        return np.asarray(index[..., 1] * self.columns + index[..., 0])

    def neighbours(self) -> Ints:
        """The cell that each move leads to, shape (cells, 4).

        Out of the room is where one was, and so is, where walls are solid, any cell whose centre
        lies across a wall or on it: the straight line between the centres must touch none.
        """
        cell = np.arange(self.cells)
        place = np.stack([cell % self.columns, cell // self.columns], axis=-1)
        moved = place[:, None, :] + STEPS
        free = ((moved >= 0) & (moved < (self.columns, self.rows))).all(axis=-1)
        if self.solid:
            free &= ~self._walled((moved + 0.5) * self.cell_m)
        return np.where(free, moved[..., 1] * self.columns + moved[..., 0], cell[:, None])

    def _walled(self, stop_m: Floats) -> Bools:
        """Which moves touch a wall, given where each ends, (cells, 4, 2); shape (cells, 4)."""
        start_m = self.centres()[:, None]
        low_m, high_m = np.minimum(start_m, stop_m), np.maximum(start_m, stop_m)
        walled = np.zeros(stop_m.shape[:2], dtype=bool)
        for wall in self.walls.reshape(-1, 2, 2):
            beside = (low_m <= wall.max(axis=0)) & (high_m >= wall.min(axis=0))
            near = beside.all(axis=-1)
            walled[near] |= _touches(low_m[near], high_m[near], wall[0], wall[1])
        return walled

    def slots_to(self, destinations: Ints, most: int = UNREACHABLE) -> Ints:
        """Fewest slots from every cell to n destinations along the moves that robots have.

        Returns:
            Slots, shape (cells, n); ``UNREACHABLE`` where solid walls leave no way. With them ways
            of more than ``most`` slots are not looked for, which saves time.
        """
        if not self.solid:
            return self.shortest_slots(np.arange(self.cells)[:, None], destinations)
        moves = self.neighbours()
        slots = np.full((self.cells, len(destinations)), UNREACHABLE)
        for column, destination in zip(slots.T, destinations, strict=True):
            front, length = np.array([destination]), 0
            while len(front) and length <= most:
                column[front] = length
                reached = np.unique(moves[front])
                front, length = reached[column[reached] == UNREACHABLE], length + 1
        return slots

    def shortest_slots(self, start: Ints, destination: Ints) -> Ints:
        """Fewest slots where no wall is solid: the Manhattan length in cells, broadcast shape."""
        columns = np.abs(start % self.columns - destination % self.columns)
        rows = np.abs(start // self.columns - destination // self.columns)
        return np.asarray(columns + rows)

    def drivable(self) -> Bools:
        """The largest part of the floor whose cells all reach each other, shape (cells,).

        All of it where walls are not solid; of parts of one size, the one with the lowest cell.
        """
        if not self.solid:
            return np.ones(self.cells, dtype=bool)
        moves, part = self.neighbours(), np.arange(self.cells)
        while True:  # each cell takes the lowest cell that it hears of, and what that one heard
            heard = np.minimum(part, part[moves].min(axis=-1))
            heard = heard[heard]
            if (heard == part).all():
                return np.asarray(part == np.bincount(part).argmax())
            part = heard


def line_of_sight(end_m: Floats, points_m: Floats, walls: Floats) -> Bools:
    """Whether the ground projection of a link crosses no wall.

    A link that touches a wall, its end included, is blocked.

    Args:
        end_m: the common end of all links, at least x and y in m, shape (2,) or (3,).
        points_m: the other ends, shape (P, 2).
        walls: segments, shape (W, 4) in m.

    Returns:
        True where the link is in line of sight, shape (P,).
    """
    if not len(walls):
        return np.ones(len(points_m), dtype=bool)
    end, point = np.asarray(end_m)[:2], points_m[:, None, :]
    return np.asarray(~_touches(end, point, walls[:, :2], walls[:, 2:]).any(axis=-1))


def _touches(end: Floats, point: Floats, a: Floats, b: Floats) -> Bools:
    """Whether the segments end-point and a-b have a point in common; all (..., 2), broadcast."""
    # Each segment's ends lie on both sides of (or on) the other segment's line.
    d1, d2 = _side(a, b, end), _side(a, b, point)
    d3, d4 = _side(end, point, a), _side(end, point, b)
    crosses = (d1 * d2 <= 0) & (d3 * d4 <= 0)
    # In line with a wall, both products are 0: they cross where their extents overlap.
    low = np.maximum(np.minimum(a, b), np.minimum(end, point))
    high = np.minimum(np.maximum(a, b), np.maximum(end, point))
    return np.asarray(crosses & (low <= high).all(axis=-1))


def _side(start: Floats, stop: Floats, point: Floats) -> Floats:
    """On which side of the line start-stop a point lies: the sign of a cross product."""
    along, to = stop - start, point - start
    return np.asarray(along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0])
