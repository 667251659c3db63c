"""Gathering: who reports what, and a plan on what was gathered."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from env.checks import checked_config
from env.oracles.gathering import gather, joined
from env.oracles.trajectory import best_trajectory
from env.radio.measured_map import Reports, fuse
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World


def floor_of(cell_m: float, robots: int = 2, **more: Any) -> World:
    config = checked_config({"room": {"cell_m": cell_m}, "robots": robots, **more})
    return World(Scenario.drawn(config, 0), stream(3, Stream.WORLD))


def same(one: Reports, other: Reports) -> bool:
    return all(np.array_equal(*parts) for parts in zip(one, other, strict=True))


def test_each_robot_that_drives_reports_the_true_gain_in_each_slot() -> None:
    world = floor_of(2.0)
    (reports,) = gather(world, 5, 1)
    world.generator = stream(5, Stream.GATHERING)
    world.reset(world.draw_starts(1))
    assert len(reports.cell) == world.shortest_slots.sum()
    assert set(world.cell[0]) == set(reports.cell[:2])
    gain = world.radio_map.gain(reports.cell[:, None], reports.phase)[:, 0]
    np.testing.assert_array_equal(reports.gain, gain)
    np.testing.assert_array_equal(reports.direct, world.radio_map.direct[reports.cell])
    assert 1 < len(set(reports.phase)) <= world.phase_actions


def test_the_first_episodes_of_many_are_those_of_few_and_the_world_stays() -> None:
    world = floor_of(2.0)
    world.reset()
    before, drawn = world.state(), world.generator.bit_generator.state
    few, many = gather(world, 0, 2), gather(world, 0, 5)
    assert len(many) == 5
    assert all(same(one, other) for one, other in zip(few, many[:2], strict=True))
    assert not same(many[0], many[1])
    assert not same(gather(world, 1, 1)[0], few[0])
    assert all(np.array_equal(before[name], array) for name, array in world.state().items())
    assert world.generator.bit_generator.state == drawn


def test_noise_spreads_the_gains_by_its_deviation_and_moves_nothing_else() -> None:
    world = floor_of(1.0, robots=3)
    clear, noisy = (joined(gather(world, 0, 40, noise_db)) for noise_db in (0.0, 2.0))
    assert same(clear._replace(gain=noisy.gain), noisy)
    error_db = 10.0 * np.log10(noisy.gain / clear.gain)
    assert error_db.mean() == pytest.approx(0.0, abs=0.2)
    assert error_db.std() == pytest.approx(2.0, rel=0.05)


def test_robots_that_block_each_other_gather_too() -> None:
    reports = joined(gather(floor_of(2.0, robots=3, collisions="block"), 0, 3))
    assert len(reports.cell) > 0


def test_a_plan_on_the_whole_map_measured_is_the_oracles() -> None:
    world = floor_of(2.0, robots=3)
    reports = joined(gather(world, 0, 300))
    cells, phases = len(world.next_cell), world.phase_actions
    cell, phase = np.divmod(np.arange(cells * phases), phases)
    true = world.radio_map
    rest = Reports(cell, phase, true.gain(cell[:, None], phase)[:, 0], true.direct[cell])
    fused = fuse(joined([reports, rest]), world.floor.centres(), true.settings)
    known = World(Scenario(world.config, world.destinations, fused), world.generator)
    for start in world.draw_starts(3):
        plan, best = (best_trajectory(each, start, 2) for each in (known, world))
        for part in ("phase", "direction", "level"):
            np.testing.assert_array_equal(getattr(plan, part), getattr(best, part))
        assert plan.value == pytest.approx(best.value, rel=1e-9)
