"""The best whole trajectories of an episode: motion, phases and powers, for the objective (5a).

One robot's path at a time is optimised by dynamic programming over (slots gone, cell) while the
others' paths stay, until no robot gains: a best response over paths in which every slot is served
by the oracle of one slot. It is exact for one robot, within its horizon; for several it is a bound
that can be reached, from below. Moves are the world's own, ``World.next_cell``.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from env.arrays import Bools, Floats, Ints
from env.oracles import paths, per_slot
from env.world import World

LEAST_GAIN = 1e-12
"""The relative gain below which a path counts as no better."""


@dataclass(frozen=True)
class Trajectory:
    """A plan for an episode of T slots, as arguments of ``World.step``.

    Attributes:
        phase: the AP's actions, shape (T,).
        direction: indices into ``floor.DIRECTIONS``, shape (T, K); 0 after arrival.
        level: power levels, shape (T, K); 1 after arrival.
        value: the objective (5a) in bit/s/Hz/J, with eta_k for R_k under ``metric=qoe``.
        sweeps: the value at the start and after each sweep over the robots.
    """

    phase: Ints
    direction: Ints
    level: Ints
    value: float
    sweeps: tuple[float, ...]


def best_trajectory(world: World, start: Ints, slack: int = 4, max_sweeps: int = 10) -> Trajectory:
    """Plans an episode whose robots all arrive, each at most ``slack`` slots after the soonest.

    Args:
        world: the environment; not changed.
        start: the cells that the robots start from, shape (K,).
        slack: extra slots that a robot may take, each number of them being tried.
        max_sweeps: most sweeps over the robots.

    Raises:
        ValueError: channels change in each slot, or a robot has no way that ends in time.
    """
    if world.config.channel.fading == "slot":
        raise ValueError(
            "env.channel.fading=slot: allowed is static or none: a plan needs channels that stay"
        )
    planner = _Planner(world, start, slack)
    values = [planner.best(planner.cells).value.sum()]
    for _ in range(max_sweeps):
        found = values[-1]
        for robot in range(world.robots):
            found = planner.improve(robot, found)
        values.append(found)
        if found <= values[-2]:
            break
    return planner.plan(values)


def shortest_ways(world: World, cell: Ints) -> Ints:
    """The next moves of shortest ways, shape (..., K), from cells of that shape."""
    there = copy.copy(world)
    there.cell = cell
    return per_slot.shortest_directions(there)


class _Planner:
    """The paths of K robots, and the search for better ones.

    Attributes:
        ways: the directions of each robot.
        cells: the cells of each robot in each slot that it drives, and at last its destination.
    """

    def __init__(self, world: World, start: Ints, slack: int) -> None:
        self.world = copy.copy(world)  # of its own cells, sharing the tables
        self.start, self.slack, self.after = start, slack, world.next_cell
        self.blocks = world.config.collisions == "block"
        self.ways: list[paths.Path] = []
        self.cells: list[Ints] = []
        for robot in range(world.robots):
            path = self._first(robot)
            self.ways.append(path)
            self.cells.append(paths.cells_along(self.after, int(start[robot]), path))

    def best(self, cells: list[Ints]) -> per_slot.BestSlots:
        """The oracle of each slot along paths given by their cells, arrays (1, T, ...)."""
        slots = np.array([len(path) - 1 for path in cells])
        cell, driving = _places(cells, np.arange(slots.max(initial=0)))
        return self._oracle(cell, driving, slots[None])

    def improve(self, robot: int, value: float) -> float:
        """Takes a robot's best path if it makes the value larger; returns the value."""
        others = [path if j != robot else path[:1] for j, path in enumerate(self.cells)]
        rest = self.best(others).value[0]
        found = self._respond(robot, rest)
        if found is None or found[0] <= value + LEAST_GAIN * abs(value):
            return value
        self.ways[robot] = found[1]
        self.cells[robot] = paths.cells_along(self.after, int(self.start[robot]), found[1])
        return found[0]

    def plan(self, values: list[float]) -> Trajectory:
        """The paths as they are, with the phases and powers of their slots."""
        best = self.best(self.cells)
        direction = np.zeros(best.level.shape[1:], dtype=np.int64)
        for robot, path in enumerate(self.ways):
            direction[: len(path), robot] = path
        value = float(best.value.sum())
        sweeps = tuple(float(each) for each in values)
        return Trajectory(best.phase[0], direction, best.level[0], value, sweeps)

    def _first(self, robot: int) -> paths.Path:
        """A shortest way; around the robots before it where they block each other."""
        cell, slots = int(self.start[robot]), self._soonest(robot)
        goal = int(self.world.destinations[robot])
        if self.blocks or cell == goal or slots not in self._horizons(robot):
            return self._free_way(robot)
        here, path = self.start.copy(), np.zeros(slots, dtype=np.int64)
        for slot in range(slots):
            path[slot] = shortest_ways(self.world, here)[robot]
            here[robot] = self.after[here[robot], path[slot]]
        return path

    def _free_way(self, robot: int) -> paths.Path:
        """The soonest way that the robots planned so far leave free."""
        for slots in self._horizons(robot):
            moves = self._moves(robot, slots)
            ways = paths.ways_to(self.after, int(self.world.destinations[robot]), moves)
            if ways[0][self.start[robot]]:
                nothing = np.zeros((slots, len(self.after)))
                return paths.best_way(self.after, int(self.start[robot]), nothing, moves, ways)[1]
        raise ValueError(
            f"env.motion.max_slots={self.world.config.motion.max_slots}: robot {robot} finds no"
            f" way of at most {self.slack} extra slots; allowed is a horizon that leaves it one"
        )

    def _respond(self, robot: int, rest: Floats) -> tuple[float, paths.Path] | None:
        """The robot's best path and the value of all with it; None if there is none."""
        horizons = list(self._horizons(robot))
        if not horizons:
            return None
        moves = self._moves(robot, horizons[-1])
        start, goal = int(self.start[robot]), int(self.world.destinations[robot])
        reached = paths.ways_from(self.after, start, goal, moves)
        used, ways = np.zeros_like(reached), {}
        for slots in horizons:
            ways[slots] = paths.ways_to(self.after, goal, moves[:slots])
            used[:slots] |= reached[:slots] & ways[slots][:slots]
        stages = self._stages(robot, used, horizons)
        best: tuple[float, paths.Path] | None = None
        for stage, slots in zip(stages, horizons, strict=True):
            value, path = paths.best_way(self.after, start, stage[:slots], moves, ways[slots])
            value += float(rest[slots:].sum())
            if value > (-np.inf if best is None else best[0]):
                best = value, path
        return best

    def _stages(self, robot: int, used: Bools, horizons: list[int]) -> Floats:
        """What a slot with the robot in a cell is worth, shape (horizons, T, cells), or -inf."""
        time, cell = np.nonzero(used)
        cells, driving = _places(self.cells, time)
        cells[:, robot], driving[:, robot] = cell, True
        slots = np.tile([len(path) - 1 for path in self.cells], (len(horizons), 1))
        slots[:, robot] = horizons
        stages = np.full((len(horizons), *used.shape), -np.inf)
        stages[:, time, cell] = self._oracle(cells, driving, slots).value
        return stages

    def _moves(self, robot: int, slots: int) -> Bools:
        """Which moves the robot may make in each slot, shape (slots, cells, 4)."""
        others = [path for other, path in enumerate(self.cells) if other != robot]
        later = range(max(len(self.cells), robot + 1), self.world.robots)
        others += [np.repeat(self.start[other], 2) for other in later]
        return paths.free_moves(self.after, slots, others if self.blocks else [])

    def _soonest(self, robot: int) -> int:
        """The fewest slots that bring the robot to its destination, at least 1."""
        after = self.after[self.start[robot]]
        return 1 + int(self.world.slots_to_go[after, robot].min())

    def _horizons(self, robot: int) -> range:
        soonest = self._soonest(robot)
        last = min(soonest + self.slack, self.world.config.motion.max_slots)
        return range(soonest, last + 1)

    def _oracle(self, cell: Ints, driving: Bools, slots: Ints) -> per_slot.BestSlots:
        """The oracle of T slots, cells (T, K), for W sets of slots to drive, (W, K)."""
        self.world.cell, self.world.driving = cell, driving
        weights = per_slot.objective_weights(self.world, slots)[:, None]
        return per_slot.best_slots(self.world, np.broadcast_to(weights, (len(slots), *cell.shape)))


def _places(cells: list[Ints], time: Ints) -> tuple[Ints, Bools]:
    """Where robots are after so many slots, (T,), of their paths, and who drives then; (T, K)."""
    slots = np.array([len(path) - 1 for path in cells])
    at = np.minimum(time[:, None], slots)
    cell = np.stack([path[i] for path, i in zip(cells, at.T, strict=True)], axis=-1)
    return cell, time[:, None] < slots
