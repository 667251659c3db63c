"""Fading of the direct channel: a radio map, none, or drawn anew in each slot."""

import math
from dataclasses import replace

import numpy as np
import pytest

from env.apis.fleet_infos import AP
from env.apis.parallel_env import RISFleetParallelEnv
from env.config import ChannelConfig, EnvConfig
from env.local_env import LocalEnv
from env.mdp.actions import ActionSpace
from env.oracles import per_slot
from env.radio.radio_map import build_radio_map
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World

SLOT = EnvConfig(robots=3, channel=ChannelConfig(fading="slot"))
FADINGS = ("static", "none", "slot")


def make(config, worlds=1, seed=0):
    world = World(Scenario.drawn(config, seed), stream(seed, Stream.WORLD), worlds)
    world.reset()
    return world


def out_of_the_room(world):
    """Actions that leave every robot of a world in the south-west corner where it is."""
    worlds, robots = world.cell.shape
    phase = np.zeros(worlds, dtype=np.int64)
    return phase, np.full((worlds, robots), 1), np.ones((worlds, robots), dtype=np.int64)


def test_without_fading_the_direct_channel_is_its_path_loss():
    tables = build_radio_map(EnvConfig(channel=ChannelConfig(fading="none")))
    for cell, clear in ((3599, True), (0, False)):
        at = ((cell % 60 + 0.5) * 0.5, (cell // 60 + 0.5) * 0.5, 1.0)
        d, f = math.log10(math.dist(at, (15, 30, 2))), math.log10(2.4)
        loss_db = 32.4 + 17.3 * d + 20 * f
        if not clear:
            loss_db = max(loss_db, 17.3 + 38.3 * d + 24.9 * f)
        assert tables.direct[cell] == pytest.approx(10 ** (-loss_db / 20))
        assert tables.direct_db[cell] == pytest.approx(-loss_db, rel=1e-6)


@pytest.mark.parametrize("los_phase", ["zero", "distance"])
def test_the_map_of_slot_fading_is_that_without_fading(los_phase):
    none, slot = (
        build_radio_map(EnvConfig(channel=ChannelConfig(fading=fading, los_phase=los_phase)))
        for fading in ("none", "slot")
    )
    assert (none.direct == slot.direct).all()
    assert (none.reflected == slot.reflected).all()


@pytest.mark.parametrize("fading", ["static", "none"])
def test_a_channel_that_stays_is_that_of_the_map(fading):
    world = make(replace(SLOT, channel=ChannelConfig(fading=fading)), worlds=4)
    assert (world.direct == world.radio_map.direct[world.cell]).all()
    assert (world.measured_db == world.radio_map.direct_db[world.cell]).all()
    assert world.measured_db.dtype == np.float32
    phase = np.array([0, 1, 2, 3])
    assert (world.channel(phase) == world.radio_map.channel(world.cell, phase)).all()
    before = world.generator.bit_generator.state
    world.step(*out_of_the_room(world))
    assert world.generator.bit_generator.state == before


def test_each_slot_and_episode_draws_a_new_channel_where_a_robot_stands_still():
    world = make(SLOT, worlds=2)
    start = np.zeros_like(world.cell)
    world.reset(start)
    seen = [world.direct]
    for _ in range(3):
        world.step(*out_of_the_room(world))
        seen.append(world.direct)
    world.reset(start)
    seen.append(world.direct)
    assert (world.cell == start).all()
    assert len(np.unique(np.stack(seen))) == 5 * seen[0].size


@pytest.mark.parametrize(("cell", "los"), [(0, False), (3599, True)])
def test_slots_fade_by_the_law_of_the_map(cell, los):
    world = make(SLOT, worlds=40_000)
    world.reset(np.full_like(world.cell, cell))
    assert world.radio_map.direct_los[cell] == los
    factor = world.direct / world.radio_map.direct[cell]
    k = 10**0.7 if los else 0.0
    assert np.mean(np.abs(factor) ** 2) == pytest.approx(1.0, abs=0.012)
    assert factor.mean() == pytest.approx(math.sqrt(k / (k + 1)), abs=0.01)
    assert np.var(factor) == pytest.approx(1 / (k + 1), rel=0.02)


def test_slot_fading_repeats_with_the_seed_and_leaves_the_first_starts():
    first, again, other = make(SLOT), make(SLOT), make(SLOT, seed=1)
    static = make(replace(SLOT, channel=ChannelConfig()))
    assert (first.cell == static.cell).all()
    for _ in range(5):
        assert (first.direct == again.direct).all()
        assert (first.direct != other.direct).all()
        for world in (first, again, other):
            world.step(*out_of_the_room(world))


def test_rates_and_observations_of_a_slot_have_its_own_channel():
    world = make(SLOT, worlds=5)
    generator = np.random.default_rng(0)
    robots = LocalEnv(Scenario(SLOT, world.destinations))
    for _ in range(10):
        direct, db = world.direct, world.measured_db
        assert db == pytest.approx(20 * np.log10(np.abs(direct)), rel=1e-6)
        local, seen = world.local_observations(), world.global_observation().reshape(5, 3, 8)
        assert local[..., 2] == pytest.approx((db + 70) / 20, rel=1e-5, abs=1e-6)
        unit = direct / np.abs(direct)
        assert seen[..., 3] == pytest.approx(unit.real, abs=1e-6)
        assert seen[..., 4] == pytest.approx(unit.imag, abs=1e-6)
        assert robots.observe(world.cell[0].astype(np.int32), db[0]).tobytes() == local[0].tobytes()
        phase = generator.integers(4, size=5)
        direction, level = generator.integers(4, size=(5, 3)), generator.integers(1, 7, size=(5, 3))
        theta = world.radio_map.settings[phase]
        reflected = (world.radio_map.reflected[world.cell] * theta[:, None]).sum(-1)
        gain = np.abs(direct + reflected) ** 2
        assert np.abs(world.channel(phase)) ** 2 == pytest.approx(gain)
        drove = world.driving
        outcome = world.step(phase, direction, level)
        expected = world.downlink.allocate(gain, level, drove)
        assert outcome.rate == pytest.approx(expected.rate)


@pytest.mark.parametrize("fading", FADINGS)
def test_the_oracle_knows_the_channel_of_the_slot(fading):
    world = make(replace(SLOT, channel=ChannelConfig(fading=fading)), worlds=3)
    gain = per_slot.phase_gains(world)
    for action in range(4):
        channel = world.channel(np.full(3, action))
        assert gain[:, action] == pytest.approx(np.abs(channel) ** 2)


def test_blocks_of_worlds_can_fade_alike():
    world = make(SLOT, worlds=2)
    start = np.repeat(world.cell[:1], 6, axis=0)
    world.reset(start, [stream(7, Stream.EVALUATION) for _ in range(3)])
    for _ in range(4):
        blocks = world.direct.reshape(3, 2, 3)
        assert (blocks[0] == blocks[1]).all()
        assert (blocks[0] == blocks[2]).all()
        assert (blocks[0, 0] != blocks[0, 1]).all()
        world.step(*out_of_the_room(world))


def test_the_view_reports_the_gain_that_the_slot_was_served_with():
    view = RISFleetParallelEnv(SLOT)
    view.reset(seed=3)
    for phase in (0, 2, 1):
        world = view.world
        gain_db = 20 * np.log10(np.abs(world.channel(np.array([phase]))))[0]
        action = int(ActionSpace(6).encode(np.array(1), np.array(2)))
        *_, infos = view.step({**dict.fromkeys(view.robots, action), AP: phase})
        for k, name in enumerate(view.robots):
            assert infos[name]["gain_db"] == pytest.approx(gain_db[k])
