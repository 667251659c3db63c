"""Worlds that begin their next episode by themselves, while others go on."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from env.config import ChannelConfig, EnvConfig, MotionConfig, TasksConfig
from env.episode import EpisodeAccumulator
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import StepResult, World

SHORT = MotionConfig(max_slots=119)
CORNERS = [[0.25, 0.25], [29.75, 29.75], [3.0, 4.0]]
VARIANTS = {
    "static": EnvConfig(motion=SHORT),
    "fading_each_slot": EnvConfig(motion=SHORT, channel=ChannelConfig(fading="slot")),
    "no_shared_cells": EnvConfig(motion=SHORT, collisions="block"),
    "fixed_starts": EnvConfig(motion=SHORT, tasks=TasksConfig(start="fixed", starts_m=CORNERS)),
}
CHOSEN = np.array([False, True, False, True])


def make(config: EnvConfig, worlds: int = 1) -> World:
    """Worlds whose first episode has begun."""
    made = World(Scenario.drawn(config, 0), stream(0, Stream.WORLD), worlds)
    made.reset()
    return made


def random_actions(world: World, generator: np.random.Generator) -> tuple[NDArray[np.int64], ...]:
    """A phase for each world, a direction and a power level for each robot."""
    shape = world.cell.shape
    return (
        generator.integers(world.phase_actions, size=shape[0]),
        generator.integers(4, size=shape),
        generator.integers(1, world.config.power.levels + 1, size=shape),
    )


def roll(world: World, slots: int) -> list[StepResult]:
    """Random slots, the same for all worlds of one number."""
    generator = np.random.default_rng(5)
    return [world.step(*random_actions(world, generator)) for _ in range(slots)]


def shown(world: World) -> list[NDArray[Any]]:
    """Arrays that a world gives out."""
    return [
        world.cell,
        world.driving,
        world.slot,
        world.measured_db,
        world.local_observations(),
        world.global_observation(),
    ]


@pytest.mark.parametrize("variant", VARIANTS)
def test_one_world_is_restarted_as_it_is_reset(variant: str) -> None:
    one, other = make(VARIANTS[variant]), make(VARIANTS[variant])
    for world in (one, other):
        roll(world, 5)
    one.reset()
    other.restart(np.array([True]))
    for array, as_reset in zip(shown(other), shown(one), strict=True):
        assert array.tobytes() == as_reset.tobytes()
    assert other.generator.bit_generator.state == one.generator.bit_generator.state
    for restarted, reset in zip(roll(other, 9), roll(one, 9), strict=True):
        assert restarted.rate.tobytes() == reset.rate.tobytes()
    assert other.measured_db.tobytes() == one.measured_db.tobytes()


@pytest.mark.parametrize("variant", VARIANTS)
def test_only_the_chosen_worlds_begin_anew_and_what_was_given_out_stays(variant: str) -> None:
    world = make(VARIANTS[variant], worlds=4)
    roll(world, 7)
    given = shown(world)
    before = [array.copy() for array in given]
    world.restart(CHOSEN)
    for array, now, old in zip(given, shown(world), before, strict=True):
        np.testing.assert_array_equal(array, old)
        np.testing.assert_array_equal(now[~CHOSEN], old[~CHOSEN])
    assert world.slot.tolist() == [7, 0, 7, 0]
    assert world.driving.all()
    assert (world.cell[CHOSEN] != given[0][CHOSEN]).any(axis=-1).all()
    assert (world.measured_db[CHOSEN] != given[3][CHOSEN]).any(axis=-1).all()
    if variant != "fixed_starts":
        centres = world.floor.centres()
        away = np.linalg.norm(centres[world.cell] - centres[world.destinations], axis=-1)
        assert away[CHOSEN].min() >= world.config.tasks.start_distance_m


def test_a_restarted_world_has_the_time_of_a_whole_episode() -> None:
    world = make(EnvConfig(motion=SHORT, tasks=TasksConfig(start_distance_m=20.0)), worlds=4)
    generator, ends = np.random.default_rng(0), np.zeros(4, dtype=np.int64)
    for slot in range(1, 200):
        outcome = world.step(*random_actions(world, generator))
        ends[outcome.truncated & (ends == 0)] = slot
        if slot == 40:
            world.restart(CHOSEN)
    assert ends.tolist() == [119, 159, 119, 159]


def test_episodes_are_counted_anew_in_the_worlds_that_are_restarted() -> None:
    """They have the measures of worlds that were reset to the same starts."""
    config = VARIANTS["static"]
    world = make(config, worlds=4)
    tally, generator = EpisodeAccumulator(world), np.random.default_rng(0)
    for _ in range(9):
        tally.add(world.step(*random_actions(world, generator)))
    seen = tally.measures()
    names = [each.name for each in fields(seen)]
    before = {name: getattr(seen, name).copy() for name in names}
    world.restart(CHOSEN)
    tally.restart(CHOSEN)
    for name in names:  # measures that were given out stay, and so do the other worlds' counts
        np.testing.assert_array_equal(getattr(seen, name), before[name], err_msg=name)
        others = getattr(tally.measures().of(~CHOSEN), name)
        np.testing.assert_array_equal(others, before[name][~CHOSEN], err_msg=name)
    alone = World(world.scenario, stream(1, Stream.WORLD), 2)
    alone.reset(world.cell[CHOSEN])
    expected = EpisodeAccumulator(alone)
    for _ in range(20):
        phase, direction, level = random_actions(world, generator)
        tally.add(world.step(phase, direction, level))
        expected.add(alone.step(phase[CHOSEN], direction[CHOSEN], level[CHOSEN]))
    for name in names:
        found = getattr(tally.measures().of(CHOSEN), name)
        np.testing.assert_array_equal(found, getattr(expected.measures(), name), err_msg=name)
    assert tally.measures().slots.tolist() == [29, 20, 29, 20]
