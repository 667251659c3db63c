"""The codebook: beams of elements that are set one by one, each for a sector of the floor."""

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test

from env.apis.parallel_env import RISFleetParallelEnv
from env.config import (
    AccessPointConfig,
    EnvConfig,
    RisConfig,
    RoomConfig,
    WallsConfig,
    phase_actions,
)
from env.config_checks import problems
from env.geometry.floor import Floor
from env.oracles.per_slot import best_phase
from env.radio import codebook
from env.radio.propagation import phases
from env.radio.radio_map import build_radio_map
from env.rendering.drawing import best_gain_db
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World

AP_M, RIS_M = np.array([15.0, 30.0, 2.0]), np.array([30.0, 7.5, 2.0])
CELLS = (0, 59, 900, 1234, 1799, 3599)


def surface(response="near", **ris):
    ris = {"side": 6, "sectors": [3, 2], "action": "codebook", **ris}
    return EnvConfig(ris=RisConfig(response=response, **ris))


def places(config):
    centres = Floor.from_config(config).centres()
    return np.column_stack([centres, np.ones(len(centres))]) - RIS_M


def indices(config):
    sector = codebook.sector_of_cells(Floor.from_config(config), *config.ris.sectors)
    return codebook.beams(
        codebook.Panel.from_config(config), places(config), sector, config.ris.bits
    )


@pytest.mark.parametrize("bits", [1, 2, 3])
def test_a_phase_goes_to_the_nearest_of_the_papers_set(bits):
    theta = np.linspace(-7, 7, 501)
    allowed = phases(bits)
    found = allowed[codebook.quantise(theta, bits)]
    away = np.abs(np.angle(np.exp(1j * (theta - found))))
    nearest = np.abs(np.angle(np.exp(1j * (theta[:, None] - allowed)))).min(axis=1)
    np.testing.assert_allclose(away, nearest, atol=1e-12)


@pytest.mark.parametrize("bits", [1, 2, 3])
def test_every_element_of_every_beam_has_one_of_the_quantised_phases(bits):
    index = indices(surface(bits=bits))
    assert index.shape == (6, 36)
    assert set(np.unique(index)) <= set(range(2**bits))
    assert len(np.unique(index)) > 1
    assert len(np.unique(index, axis=0)) == 6


@pytest.mark.parametrize("response", ["far", "near"])
def test_the_table_is_the_papers_product_with_a_phase_matrix(response):
    config = surface(response)
    tables, panel, index = (
        build_radio_map(config),
        codebook.Panel.from_config(config),
        indices(config),
    )
    for cell in CELLS:
        for beam in (0, 2, 5):
            total = 0j
            for element, offset in enumerate(panel.offsets_m):
                path_m = 0.0
                for end in (AP_M - RIS_M, places(config)[cell]):
                    far_m = math.dist(end, (0, 0, 0))
                    path_m += (
                        math.dist(end, offset) - far_m
                        if response == "near"
                        else -float(end @ offset) / far_m
                    )
                theta = (index[beam, element] + 0.5) * math.pi / 2
                total += cmath.exp(1j * (theta - 2 * math.pi * path_m / panel.wavelength_m))
            alone = build_radio_map(surface("coherent", side=1, action="phases"))
            expected = complex(alone.reflected[cell, 0]) * total
            assert tables.reflected[cell, beam] == pytest.approx(expected, rel=1e-6, abs=1e-14)
            found = tables.channel(np.array([cell]), np.array(beam))[0]
            assert found == tables.direct[cell] + tables.reflected[cell, beam]


def test_moving_all_indices_on_by_one_turns_the_reflection_by_one_phase_step():
    config = surface()
    panel, index, at = codebook.Panel.from_config(config), indices(config), places(config)[::97]
    found = codebook.factors(panel, at, index, 2)
    moved = codebook.factors(panel, at, (index + 1) % 4, 2)
    np.testing.assert_allclose(moved, found * 1j, rtol=1e-9, atol=1e-9)


def test_each_round_of_spreading_raises_the_mean_size_over_the_sector():
    config = surface(side=20)
    waves = codebook.Panel.from_config(config).waves(places(config)[300:420:3])
    theta = np.conj(waves[len(waves) // 2])
    means = []
    for _ in range(6):
        means.append(np.abs(waves @ theta).mean())
        theta = codebook._align(waves, theta)
    assert (np.diff(means) >= -1e-9).all()
    assert means[-1] > 1.2 * means[0]
    np.testing.assert_allclose(np.abs(theta), 1.0)


def test_with_one_point_every_element_adds_in_phase():
    config = surface()
    waves = codebook.Panel.from_config(config).waves(places(config)[77:78])
    assert np.abs(waves @ np.exp(1j * codebook.focus(waves))) == pytest.approx([36])


def test_sectors_are_blocks_of_cells_row_by_row():
    floor = Floor(6, 4, 0.5, np.zeros((0, 4)))
    found = codebook.sector_of_cells(floor, 3, 2).reshape(4, 6)
    np.testing.assert_array_equal(found[:2], [[0, 0, 1, 1, 2, 2]] * 2)
    np.testing.assert_array_equal(found[2:], [[3, 3, 4, 4, 5, 5]] * 2)
    uneven = codebook.sector_of_cells(Floor(7, 5, 0.5, np.zeros((0, 4))), 7, 3)
    assert (np.bincount(uneven) >= 1).all()
    assert len(np.bincount(uneven)) == 21


@pytest.mark.parametrize(("response", "least_db"), [("near", 10.0), ("far", 9.0)])
def test_in_the_shadow_beams_gain_what_one_phase_for_all_does_not(response, least_db):
    room = RoomConfig(cell_m=1.0)
    beams = build_radio_map(replace(surface(response, side=40, sectors=[6, 6]), room=room))
    mirror = build_radio_map(replace(surface(response, side=40, action="phases"), room=room))
    more_db = (best_gain_db(beams) - best_gain_db(mirror))[~beams.direct_los]
    assert more_db.mean() > least_db


def test_the_tables_are_the_same_each_time_and_hold_no_draw():
    first, again = (build_radio_map(surface()) for _ in range(2))
    other = build_radio_map(EnvConfig(map_seed=1, ris=surface().ris))
    assert (first.reflected == again.reflected).all()
    assert (first.reflected == other.reflected).all()
    assert (first.direct != other.direct).any()


def test_gains_are_looked_up_for_each_world_and_robot():
    tables = build_radio_map(surface())
    cell, action = np.array([[0, 900, 77], [5, 5, 3599]]), np.array([4, 1])
    expected = np.abs(tables.direct[cell] + tables.reflected[cell, action[:, None]]) ** 2
    np.testing.assert_allclose(tables.gain(cell, action), expected)
    np.testing.assert_allclose(tables.gain(cell, action, tables.direct[cell]), expected)


def test_an_oracle_reads_every_beam():
    config = surface()
    world = World(Scenario.drawn(config, 0), stream(0, Stream.WORLD), worlds=2)
    world.reset()
    every = world.channel(np.arange(world.phase_actions)[None])
    assert every.shape == (2, 6, 3)
    for action in range(6):
        assert (every[:, action] == world.channel(np.full(2, action))).all()
    level = np.tile([1, 2, 3], (2, 1))
    assert best_phase(world, level).shape == (2,)


@pytest.mark.parametrize(
    ("ris", "actions"),
    [
        (RisConfig(), 4),
        (RisConfig(bits=3, subsurfaces=2), 64),
        (RisConfig(response="far", action="codebook", sectors=[5, 3]), 15),
    ],
)
def test_one_function_counts_the_actions_of_the_access_point(ris, actions):
    config = EnvConfig(ris=ris, room=RoomConfig(cell_m=1.0))
    assert phase_actions(ris) == actions
    assert len(build_radio_map(config).settings) == actions
    assert RISFleetParallelEnv(config).action_space("ap").n == actions


@pytest.mark.parametrize("response", ["far", "near"])
def test_the_fleets_view_keeps_to_the_interface(response):
    parallel_api_test(RISFleetParallelEnv(surface(response)), num_cycles=30)


@pytest.mark.parametrize(
    ("ris", "key", "says"),
    [
        ({"response": "coherent"}, "env.ris.response", "far or near"),
        ({"response": "rayleigh"}, "env.ris.response", "far or near"),
        ({"subsurfaces": 4}, "env.ris.subsurfaces", "1 with env.ris.action=codebook"),
        ({"side": 0}, "env.ris.side", "at least 1"),
        ({"sectors": [6]}, "env.ris.sectors", "1 to 60"),
        ({"sectors": [0, 6]}, "env.ris.sectors", "1 to 60"),
        ({"sectors": [61, 6]}, "env.ris.sectors", "1 to 60"),
        ({"sectors": [60, 60]}, None, None),
        ({"action": "phases", "subsurfaces": 4}, None, None),
    ],
)
def test_what_beams_cannot_be_made_of_is_refused(ris, key, says):
    found = problems(surface(**ris))
    assert [name for name, _, _ in found] == ([key] if key else [])
    assert all(says in allowed for _, _, allowed in found)


def test_more_beams_than_actions_are_refused():
    config = EnvConfig(
        room=RoomConfig(width_m=65.0, depth_m=65.0), ris=surface(sectors=[65, 64]).ris
    )
    assert [(key, allowed[:12]) for key, _, allowed in problems(config)] == [
        ("env.ris.sectors", "at most 4096")
    ]


@pytest.mark.parametrize(
    ("response", "action"),
    [("far", "phases"), ("near", "phases"), ("near", "codebook"), ("coherent", "phases")],
)
def test_more_distances_than_can_be_worked_out_are_refused(response, action):
    config = EnvConfig(
        room=RoomConfig(width_m=200.0, depth_m=200.0),
        walls=WallsConfig(segments=[]),
        ap=AccessPointConfig(),
        ris=surface(response, side=80, action=action).ris,
    )
    found = [(key, allowed) for key, _, allowed in problems(config)]
    if response == "coherent":
        assert found == []
    else:
        assert [key for key, _ in found] == ["env.ris.side"]
        assert "at most 79 " in found[0][1]
