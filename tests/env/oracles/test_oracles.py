"""Oracles find what an exhaustive look over plain slots finds, and nothing beats them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from env.checks import checked_config
from env.geometry.floor import STEPS
from env.mdp.destinations import draw_destinations
from env.oracles import per_slot
from env.radio.radio_map import build_radio_map
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World

CONFIGS: dict[str, dict[str, Any]] = {
    "project": {},
    "no_margin_kept": {"robots": 4, "ris": {"side": 0}, "power": {"max_dbm": 0.0}},
    "one_robot": {"robots": 1},
    "two_subsurfaces": {"robots": 2, "ris": {"subsurfaces": 2}, "power": {"levels": 4}},
    "residual": {"robots": 3, "power": {"resolve": "residual", "levels": 3}},
    "zero": {"robots": 2, "power": {"resolve": "zero", "levels": 4}},
    "qoe": {"metric": "qoe", "power": {"levels": 4}},
    "oma": {"access": "oma"},
    "oma_reallocate_qoe": {
        "access": "oma",
        "metric": "qoe",
        "oma": {"share": "reallocate"},
        "ris": {"subsurfaces": 2},
    },
}
few = settings(max_examples=15)


@cache
def shared(name: str) -> World:
    config = checked_config(CONFIGS[name])
    destinations = draw_destinations(config, stream(0, Stream.DESTINATIONS))
    return World(
        Scenario(config, destinations, build_radio_map(config)), stream(0, Stream.WORLD), 3
    )


@st.composite
def worlds(draw: st.DrawFn, names: tuple[str, ...] = tuple(CONFIGS)) -> World:
    """Worlds with robots anywhere, some of them no longer driving."""
    world = shared(draw(st.sampled_from(names)))
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    world.reset(random.integers(world.floor.cells, size=(3, world.robots)))
    world.driving &= random.random(world.cell.shape) < 0.8
    return world


def slot_metric(
    world: World, phase: NDArray[np.int64], level: NDArray[np.int64]
) -> NDArray[np.float64]:
    """sum_k R_k, or eta_k where driving, of a slot that is then taken back, shape (B,)."""
    cell, driving, slot = world.cell, world.driving, world.slot
    outcome = world.step(phase, np.zeros_like(level), level)
    world.cell, world.driving, world.slot = cell, driving, slot
    if world.config.metric == "qos":
        return np.asarray(outcome.rate.sum(axis=-1))
    eta = np.log10(np.maximum(outcome.rate, 0.01))
    return np.asarray(eta.sum(axis=-1, where=driving))


@given(world=worlds(), data=st.data())
@few
def test_no_fixed_phase_beats_the_best_phase(world: World, data: st.DataObject) -> None:
    random = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    level = random.integers(1, world.config.power.levels + 1, size=world.cell.shape)
    fixed = [slot_metric(world, np.full(3, phase), level) for phase in range(world.phase_actions)]
    best = slot_metric(world, per_slot.best_phase(world, level), level)
    np.testing.assert_allclose(best, np.max(fixed, axis=0), rtol=1e-12)


@given(world=worlds(), data=st.data())
@few
def test_no_picks_beat_the_best_powers(world: World, data: st.DataObject) -> None:
    phase, level = per_slot.best_phase_and_powers(world)
    best = slot_metric(world, phase, level)
    random = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    for _ in range(20):
        picks = random.integers(1, world.config.power.levels + 1, size=world.cell.shape)
        assert (slot_metric(world, per_slot.best_phase(world, picks), picks) <= best + 1e-9).all()


@pytest.mark.parametrize("name", ["two_subsurfaces", "residual", "zero", "qoe"])
def test_best_powers_are_those_of_a_plain_search(name: str) -> None:
    world = shared(name)
    world.reset(np.random.default_rng(8).integers(world.floor.cells, size=(3, world.robots)))
    every = product(range(1, world.config.power.levels + 1), repeat=world.robots)
    tried = [
        slot_metric(world, np.full(3, phase), np.tile(picks, (3, 1)))
        for picks in every
        for phase in range(world.phase_actions)
    ]
    best = slot_metric(world, *per_slot.best_phase_and_powers(world))
    np.testing.assert_allclose(best, np.max(tried, axis=0), rtol=1e-12)


@given(world=worlds(), data=st.data())
@few
def test_the_best_powers_under_a_phase_are_those_of_a_plain_search(
    world: World, data: st.DataObject
) -> None:
    random = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    phase = random.integers(world.phase_actions, size=3)
    weights = random.uniform(0.1, 3.0, size=world.cell.shape)
    gain, levels = per_slot.phase_gains(world)[np.arange(3), phase], world.config.power.levels
    np.testing.assert_array_equal(per_slot.gains(world, phase), gain)

    def value(level: NDArray[np.int64]) -> NDArray[np.float64]:
        """Of levels (C, 3, K), shape (C, 3)."""
        served = np.tile(world.driving, (len(level), 1))
        flat = level.reshape(served.shape)
        rate = world.downlink.allocate(np.tile(gain, (len(level), 1)), flat, served).rate
        if world.config.metric == "qoe":
            rate = np.where(served, np.log10(np.maximum(rate, 0.01)), 0.0)
        return np.asarray((weights * rate.reshape(level.shape)).sum(axis=-1))

    level = per_slot.best_powers(world, phase, weights)
    assert level.shape == world.cell.shape
    assert ((level >= 1) & (level <= levels)).all()
    np.testing.assert_array_equal(level[~world.driving], 1)
    every = np.array([*product(range(1, levels + 1), repeat=world.robots)])
    tried = value(np.repeat(every[:, None], 3, axis=1))
    np.testing.assert_allclose(value(level[None])[0], tried.max(axis=0), rtol=1e-12)


@given(world=worlds())
@few
def test_worlds_are_searched_for_powers_as_each_alone(world: World) -> None:
    phase = np.arange(3) % world.phase_actions
    together = per_slot.best_powers(world, phase, world.rate_weights)
    np.testing.assert_array_equal(together, per_slot.best_powers(world, phase))
    best, level = per_slot.best_phase_and_powers(world, world.rate_weights)
    np.testing.assert_array_equal(per_slot.best_powers(world, best), level)
    cell, driving = world.cell, world.driving
    for index in range(3):
        world.cell, world.driving = cell[[index]], driving[[index]]
        alone = per_slot.best_powers(world, phase[[index]])
        np.testing.assert_array_equal(alone[0], together[index])


@pytest.mark.parametrize("name", ["oma", "oma_reallocate_qoe"])
def test_under_oma_the_phase_alone_is_searched(name: str) -> None:
    world = shared(name)
    world.reset(np.random.default_rng(8).integers(world.floor.cells, size=(3, world.robots)))
    phase, level = per_slot.best_phase_and_powers(world)
    np.testing.assert_array_equal(level, 1)
    np.testing.assert_array_equal(phase, per_slot.best_phase(world, level))
    np.testing.assert_array_equal(phase, per_slot.best_phase(world, np.full_like(level, 6)))
    every = [slot_metric(world, np.full(3, a), level) for a in range(world.phase_actions)]
    np.testing.assert_array_equal(phase, np.argmax(every, axis=0))


def test_the_best_quality_spares_the_weakest_robot_what_the_best_sum_takes() -> None:
    """Baseline 3: the logarithm cares more for low rates."""
    quality, least = shared("qoe"), []
    sums = World(
        Scenario(replace(quality.config, metric="qos"), quality.destinations, quality.radio_map),
        quality.generator,
        3,
    )
    cells = np.random.default_rng(1).integers(quality.floor.cells, size=(200, quality.robots))
    for world in (quality, sums):
        world.reset(cells)
        phase, level = per_slot.best_phase_and_powers(world)
        rate = world.step(phase, np.zeros_like(level), level).rate
        least.append((rate.min(axis=-1).mean(), rate.sum(axis=-1).mean()))
    assert least[0][0] > least[1][0]
    assert least[0][1] < least[1][1]


def test_the_best_powers_are_sent_as_they_are() -> None:
    world = shared("project")
    for _ in range(5):
        world.reset()
        phase, level = per_slot.best_phase_and_powers(world)
        outcome = world.step(phase, np.zeros_like(level), level)
        kept = ~outcome.allocation.margin_dropped
        assert not outcome.allocation.projected[kept].any()


def test_a_search_in_parts_finds_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    world = shared("project")
    world.reset(np.random.default_rng(3).integers(world.floor.cells, size=(9, world.robots)))
    whole = per_slot.best_phase_and_powers(world)
    for most in (200, 40):
        monkeypatch.setattr(per_slot, "MAX_COMBINATIONS", most)
        for part, all_at_once in zip(per_slot.best_phase_and_powers(world), whole, strict=True):
            np.testing.assert_array_equal(part, all_at_once)
        np.testing.assert_array_equal(per_slot.best_powers(world, whole[0]), whole[1])
    monkeypatch.setattr(per_slot, "MAX_COMBINATIONS", 10)
    with pytest.raises(ValueError, match=r"env.power.levels=6: with 3 robots .* allowed are 10"):
        per_slot.best_phase_and_powers(world)


def test_with_nobody_driving_there_is_nothing_to_choose() -> None:
    world = shared("project")
    world.reset()
    world.driving &= False
    phase, level = per_slot.best_phase_and_powers(world)
    np.testing.assert_array_equal(phase, 0)
    np.testing.assert_array_equal(level, 1)
    np.testing.assert_array_equal(per_slot.best_phase(world, level), 0)


def test_without_a_surface_all_phases_are_one() -> None:
    world = shared("no_margin_kept")
    world.reset()
    gain = per_slot.phase_gains(world)
    np.testing.assert_array_equal(gain, np.broadcast_to(gain[:, :1], gain.shape))
    np.testing.assert_array_equal(per_slot.best_phase(world, np.ones_like(world.cell)), 0)


def test_canonical_levels_give_the_weakest_robot_most() -> None:
    gain = np.array([[3.0, 1.0, 2.0, 2.0], [3.0, 1.0, 2.0, 2.0]])
    driving = np.array([[True] * 4, [True, True, False, True]])
    levels = per_slot.canonical_levels(gain, driving, 6)
    np.testing.assert_array_equal(levels, [[4, 1, 3, 2], [3, 1, 1, 2]])
    np.testing.assert_array_equal(per_slot.canonical_levels(gain, driving, 2)[0], [2, 1, 2, 2])


@given(world=worlds(("project", "no_margin_kept", "one_robot", "two_subsurfaces")))
@few
def test_canonical_powers_are_sent_as_they_are_unless_the_margin_is_short(world: World) -> None:
    config = world.config
    gain = per_slot.phase_gains(world)[:, 0]
    level = per_slot.canonical_levels(gain, world.driving, config.power.levels)
    free = World(
        Scenario(
            replace(config, power=replace(config.power, sic_margin=0.0)),
            world.destinations,
            world.radio_map,
        ),
        world.generator,
        3,
    )
    assert not free.downlink.allocate(gain, level, world.driving).projected.any()


def bound_for(goal: int, start: int) -> World:
    config, shape = checked_config({"robots": 1}), shared("project")
    world = World(Scenario(config, np.array([goal]), shape.radio_map), stream(0, Stream.WORLD))
    world.reset(np.array([[start]]))
    return world


@given(start=st.integers(0, 3599), goal=st.integers(0, 3599))
@few
def test_shortest_directions_take_the_manhattan_length(start: int, goal: int) -> None:
    world = bound_for(goal, start)
    for left in range(int(world.shortest_slots[0, 0]), 0, -1):
        assert world.shortest_slots[0, 0] == left
        world.cell = world.next_cell[world.cell, per_slot.shortest_directions(world)]
    assert world.cell == goal


def test_shortest_directions_take_the_longer_axis_first() -> None:
    goal = 30 * 60 + 30
    ways = ((3, 1, (1, 0)), (-3, 2, (-1, 0)), (1, 2, (0, 1)), (2, -3, (0, -1)), (2, 2, (1, 0)))
    for across, up, step in ways:
        world = bound_for(goal, goal - across - up * 60)
        assert tuple(STEPS[per_slot.shortest_directions(world)[0, 0]]) == step


@pytest.mark.parametrize("name", ["two_subsurfaces", "residual", "zero", "oma", "qoe"])
def test_weighted_oracles_are_those_of_a_plain_search(name: str) -> None:
    world = shared(name)
    random = np.random.default_rng(8)
    world.reset(random.integers(world.floor.cells, size=(3, world.robots)))
    weights = random.uniform(0.1, 3.0, size=world.cell.shape)
    every = [
        np.tile(picks, (3, 1))
        for picks in product(range(1, world.config.power.levels + 1), repeat=world.robots)
    ]

    def value(phase: NDArray[np.int64], level: NDArray[np.int64]) -> NDArray[np.float64]:
        gain = per_slot.phase_gains(world)[np.arange(3), phase]
        rate = world.downlink.allocate(gain, level, world.driving).rate
        if world.config.metric == "qoe":
            rate = np.log10(np.maximum(rate, 0.01))
        return np.asarray((weights * rate).sum(axis=-1))

    phases = [np.full(3, phase) for phase in range(world.phase_actions)]
    tried = [value(phase, level) for level in every for phase in phases]
    best = value(*per_slot.best_phase_and_powers(world, weights))
    np.testing.assert_allclose(best, np.max(tried, axis=0), rtol=1e-12)
    given_powers = value(per_slot.best_phase(world, every[1], weights), every[1])
    searched = [value(phase, every[1]) for phase in phases]
    np.testing.assert_allclose(given_powers, np.max(searched, axis=0), rtol=1e-12)


def test_weights_decide_who_is_served_best() -> None:
    world = shared("project")
    world.reset(np.random.default_rng(5).integers(world.floor.cells, size=(3, world.robots)))
    for robot in range(world.robots):
        weights = np.where(np.arange(world.robots) == robot, 1.0, 1e-9)
        phase, level = per_slot.best_phase_and_powers(world, weights)
        gain = per_slot.phase_gains(world)[np.arange(3), phase]
        own = world.downlink.allocate(gain, level, world.driving).rate[:, robot]
        plain, equal = per_slot.best_phase_and_powers(world)
        gain = per_slot.phase_gains(world)[np.arange(3), plain]
        assert (own >= world.downlink.allocate(gain, equal, world.driving).rate[:, robot]).all()


def test_thousands_of_phases_are_searched_in_parts() -> None:
    """4,096 settings times 20 powers of two worlds: more than one part of a world's own."""
    config = checked_config({"ris": {"bits": 2, "subsurfaces": 6}, "room": {"cell_m": 3.0}})
    world = World(Scenario.drawn(config, 0), stream(0, Stream.WORLD), 2)
    assert world.phase_actions == 4096
    world.reset()
    rows = np.arange(2)
    phase, level = per_slot.best_phase_and_powers(world)
    best = slot_metric(world, phase, level)
    given_powers = per_slot.best_phase(world, level)
    np.testing.assert_allclose(slot_metric(world, given_powers, level), best, rtol=1e-12)
    gain = per_slot.phase_gains(world)[:, ::64]
    for index in range(gain.shape[1]):
        levels = per_slot.canonical_levels(gain[:, index], world.driving, 6)
        rate = world.downlink.allocate(gain[rows, index], levels, world.driving).rate
        assert (rate.sum(axis=-1) <= best + 1e-9).all()
