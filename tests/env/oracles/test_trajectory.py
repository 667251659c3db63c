"""Planned trajectories against enumerations on tiny floors, and replayed through the world."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from env.checks import checked_config
from env.episode import EpisodeAccumulator
from env.mdp.reward import energy_efficiency, metric, motion_energy_j
from env.oracles import paths, per_slot
from env.oracles.trajectory import Trajectory, best_trajectory, shortest_ways
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World


def floor_of(cell_m: float, robots: int, **more: Any) -> World:
    config = checked_config({"room": {"cell_m": cell_m}, "robots": robots, **more})
    return World(Scenario.drawn(config, 0), stream(3, Stream.WORLD))


def replayed(world: World, start: NDArray[np.int64], plan: Trajectory) -> EpisodeAccumulator:
    world.reset(start[None])
    tally = EpisodeAccumulator(world)
    for phase, direction, level in zip(plan.phase, plan.direction, plan.level, strict=True):
        assert world.driving.any()
        tally.add(world.step(np.array([phase]), direction[None], level[None]))
    assert not world.driving.any()
    return tally


def every_way(world: World, robot: int, start: int, most: int) -> list[tuple[int, ...]]:
    """All sequences of moves that first arrive with the last one, of at most so many."""
    found, goal = [], world.destinations[robot]
    for slots in range(1, most + 1):
        for moves in product(range(4), repeat=slots):
            cell, arrived = start, []
            for move in moves:
                cell = world.next_cell[cell, move]
                arrived.append(cell == goal)
            if arrived[-1] and sum(arrived) == 1:
                found.append(moves)
    return found


def enumerated(world: World, start: NDArray[np.int64], slack: int) -> float:
    """The largest (5a) over all joint paths, every slot served by its weighted oracle."""
    config = world.config
    ways = [
        every_way(world, k, int(start[k]), int(world.slots_to_go[start[k], k]) + slack)
        for k in range(world.robots)
    ]
    joint = list(product(*ways))
    taken = np.array([[len(way) for way in each] for each in joint])
    weights = 1.0 / (taken * motion_energy_j(taken * world.slot_s, config.motion))
    world.reset(np.tile(start, (len(joint), 1)))
    total = np.zeros(taken.shape)
    for slot in range(int(taken.max())):
        phase, level = per_slot.best_phase_and_powers(world, weights)
        move = [[way[slot] if slot < len(way) else 0 for way in each] for each in joint]
        outcome = world.step(phase, np.array(move), level)
        total += np.where(outcome.drove, outcome.rate, 0.0)
    assert not world.driving.any()
    return float(energy_efficiency(total, taken, world.slot_s, config.motion).max())


@pytest.mark.parametrize(("start", "slack"), [(0, 0), (7, 2), (1, 2), (22, 1)])
def test_one_robots_plan_is_the_best_of_all_paths(start: int, slack: int) -> None:
    world = floor_of(6.0, 1)
    plan = best_trajectory(world, np.array([start]), slack)
    best = enumerated(world, np.array([start]), slack)
    assert plan.value == pytest.approx(best, rel=1e-12)


@pytest.mark.parametrize("start", [(6, 6), (13, 11), (3, 8), (14, 2)])
@pytest.mark.parametrize("more", [{}, {"access": "oma", "oma": {"share": "reallocate"}}])
def test_two_robots_lie_between_their_shortest_ways_and_the_best_of_all(
    start: tuple[int, int], more: dict[str, Any]
) -> None:
    world = floor_of(7.5, 2, **more)
    start_cells = np.array(start)
    plan = best_trajectory(world, start_cells, 1)
    assert plan.value <= enumerated(world, start_cells, 1) * (1 + 1e-12)
    taken = world.slots_to_go[start_cells, [0, 1]]
    weights = 1.0 / (taken * motion_energy_j(taken * world.slot_s, world.config.motion))
    world.reset(start_cells[None])
    tally = EpisodeAccumulator(world)
    while world.driving.any():
        phase, level = per_slot.best_phase_and_powers(world, weights)
        tally.add(world.step(phase, shortest_ways(world, world.cell), level))
    shortest = tally.measures().ee[0]
    assert plan.sweeps[0] == pytest.approx(shortest, rel=1e-12)
    assert plan.value >= shortest * (1 - 1e-12)


@pytest.mark.parametrize(
    "more", [{}, {"access": "oma"}, {"power": {"resolve": "zero", "levels": 4}}]
)
def test_a_replay_has_the_energy_efficiency_of_the_plan(more: dict[str, Any]) -> None:
    world = floor_of(2.0, 3, **more)
    for start in world.draw_starts(3):
        plan = best_trajectory(world, start)
        measures = replayed(world, start, plan).measures()
        assert measures.success[0] == 1.0
        assert measures.ee[0] == pytest.approx(plan.value, abs=1e-9)
        extra = measures.slots[0] - world.slots_to_go[start, np.arange(3)].max()
        assert extra <= 4


def test_under_qoe_the_value_is_that_of_the_quality() -> None:
    world = floor_of(3.0, 2, metric="qoe")
    start = world.draw_starts(1)[0]
    plan = best_trajectory(world, start, 2)
    world.reset(start[None])
    eta, slots = np.zeros(2), np.zeros(2, dtype=np.int64)
    for phase, direction, level in zip(plan.phase, plan.direction, plan.level, strict=True):
        outcome = world.step(np.array([phase]), direction[None], level[None])
        eta += np.where(outcome.drove[0], metric(outcome.rate[0], world.config), 0.0)
        slots += outcome.drove[0]
    value = energy_efficiency(eta, slots, world.slot_s, world.config.motion)
    assert plan.value == pytest.approx(value, abs=1e-9)


def test_the_value_never_falls_and_motion_is_worth_something() -> None:
    world = floor_of(2.0, 3)
    gains = []
    for start in world.draw_starts(4):
        sweeps = best_trajectory(world, start).sweeps
        assert (np.diff(sweeps) >= 0).all()
        gains.append(sweeps[-1] / sweeps[0] - 1)
    assert max(gains) > 1e-3


def test_more_slack_is_never_worse_for_one_robot() -> None:
    world = floor_of(2.0, 1)
    start = world.draw_starts(1)[0]
    values = [best_trajectory(world, start, slack).value for slack in (0, 2, 4)]
    assert values == sorted(values)


def test_a_robot_at_its_destination_leaves_it_or_stays_for_a_slot() -> None:
    """As the world has it: a robot arrives with a move."""
    world = floor_of(6.0, 1)
    plan = best_trajectory(world, world.destinations, 0)
    measures = replayed(world, world.destinations, plan).measures()
    assert measures.ee[0] == pytest.approx(plan.value, abs=1e-9)
    assert len(plan.phase) == (
        1 if world.destinations[0] in world.next_cell[world.destinations[0]] else 2
    )


def test_free_moves_meet_nobody() -> None:
    world = floor_of(7.5, 1)
    other = np.array([5, 6, 7])  # it drives along a row, and arrives at 7
    free = paths.free_moves(world.next_cell, 3, [other])
    east, west, north = 2, 3, 0
    assert not free[0, 6, west]  # a swap
    assert not free[0, 2, north]  # into the cell that it takes
    assert not free[0, 1, north]  # into the cell that it leaves, if it moves later
    assert not free[0, 6].any()  # holding the cell that it takes
    assert free[0, 3, north]
    assert free[2].all()  # one that has arrived holds no cell
    assert free[0, 8, east]


@pytest.mark.parametrize("start", [[0, 24, 12], [5, 9, 20], [1, 8, 4], [12, 11, 10], [6, 7, 2]])
def test_no_planned_move_is_blocked_where_robots_block_each_other(start: list[int]) -> None:
    world = floor_of(6.0, 3, collisions="block")
    plan = best_trajectory(world, np.array(start), 4)
    measures = replayed(world, np.array(start), plan).measures()
    assert measures.ee[0] == pytest.approx(plan.value, abs=1e-9)


def test_fading_of_each_slot_is_refused() -> None:
    world = floor_of(6.0, 1, channel={"fading": "slot"})
    with pytest.raises(ValueError, match=r"env.channel.fading=slot: allowed is static or none: "):
        best_trajectory(world, np.array([0]))


def test_a_way_that_takes_too_long_is_refused() -> None:
    world = floor_of(6.0, 1, motion={"max_slots": 2})
    with pytest.raises(ValueError, match=r"env.motion.max_slots=2: .* allowed is "):
        best_trajectory(world, np.array([0]))
