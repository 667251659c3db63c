"""The radio map: the tables against a literal computation of h Theta g + hbar."""

import cmath
import dataclasses
import math
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env.config import ChannelConfig, EnvConfig, RisConfig, WallsConfig
from env.geometry.floor import Floor
from env.radio.radio_map import build_radio_map

CELLS = (0, 7, 59, 1234, 1777, 3599)


def literal_loss_db(at, end, clear, frequency_ghz=2.4):
    d, f = math.log10(math.dist(at, end)), math.log10(frequency_ghz)
    los = 32.4 + 17.3 * d + 20 * f
    return los if clear else max(los, 17.3 + 38.3 * d + 24.9 * f)


def literal_position(cell):
    return ((cell % 60 + 0.5) * 0.5, (cell // 60 + 0.5) * 0.5, 1.0)


def crosses_the_default_wall(at, end):
    """Whether a link crosses y = 15 at some x up to 21."""
    if (at[1] - 15) * (end[1] - 15) > 0:
        return False
    share = (15 - at[1]) / (end[1] - at[1])
    return at[0] + share * (end[0] - at[0]) <= 21


def literal_channel(config, cell, theta, direct):
    """The sum h Theta g + hbar with the M x M matrix diag(Theta), as the paper writes it."""
    ap, ris, at = (15, 30, 2), (30, 7.5, 2), literal_position(cell)
    m, n = config.ris.side**2, config.ris.subsurfaces
    clear = not crosses_the_default_wall(at, ris)
    g = np.full((m, 1), 10 ** (-literal_loss_db(ap, ris, True) / 20), dtype=complex)
    h = np.full((1, m), 10 ** (-literal_loss_db(at, ris, clear) / 20), dtype=complex)
    each = np.kron([cmath.exp(1j * x) for x in theta], np.ones(m // n))
    return (h @ np.diag(each) @ g)[0, 0] + direct


@pytest.mark.parametrize(
    ("side", "subsurfaces", "bits"), [(4, 1, 2), (4, 4, 1), (6, 3, 2), (30, 1, 2)]
)
def test_the_tables_give_the_papers_channel(side, subsurfaces, bits):
    config = EnvConfig(ris=RisConfig(side=side, subsurfaces=subsurfaces, bits=bits))
    tables = build_radio_map(config)
    count = 2**bits
    for action in {0, 1, count**subsurfaces // 2, count**subsurfaces - 1}:
        theta = [
            (action // count**n % count + 0.5) * 2 * math.pi / count for n in range(subsurfaces)
        ]
        found = tables.channel(np.array(CELLS), np.array(action))
        for cell, channel in zip(CELLS, found, strict=True):
            expected = literal_channel(config, cell, theta, tables.direct[cell])
            assert channel == pytest.approx(expected, rel=1e-9)


def test_without_scattering_the_direct_channel_is_the_path_loss_alone():
    tables = build_radio_map(EnvConfig(channel=ChannelConfig(rician_k_db=300.0)))
    for cell in (1800, 2400, 3599):
        loss_db = literal_loss_db(literal_position(cell), (15, 30, 2), True)
        assert tables.direct[cell] == pytest.approx(10 ** (-loss_db / 20), rel=1e-9)
        assert tables.direct_db[cell] == pytest.approx(-loss_db, rel=1e-6)


def test_behind_the_wall_the_direct_channel_fades_about_its_blocked_path_loss():
    tables = build_radio_map(EnvConfig())
    shadow = np.flatnonzero(~tables.direct_los)
    loss_db = np.array([literal_loss_db(literal_position(c), (15, 30, 2), False) for c in shadow])
    power = np.abs(tables.direct[shadow]) ** 2 / 10 ** (-loss_db / 10)
    assert power.mean() == pytest.approx(1.0, abs=0.1)
    assert np.mean(power > 1) == pytest.approx(math.exp(-1), abs=0.05)


def test_lines_of_sight_are_those_past_the_default_wall():
    tables = build_radio_map(EnvConfig())
    places = [literal_position(cell) for cell in range(3600)]
    ap = [not crosses_the_default_wall(at, (15, 30, 2)) for at in places]
    ris = [not crosses_the_default_wall(at, (30, 7.5, 2)) for at in places]
    assert tables.direct_los.tolist() == ap
    assert tables.ris_los.tolist() == ris


@given(st.integers(0, 3), st.integers(0, 2))
@settings(max_examples=8)
def test_no_surface_is_exactly_the_direct_channel(action, seed):
    tables = build_radio_map(EnvConfig(map_seed=seed, ris=RisConfig(side=0)))
    every = np.arange(3600)
    assert (tables.channel(every, np.array(action)) == tables.direct).all()


def test_the_direct_channel_knows_nothing_of_the_surface():
    without = build_radio_map(EnvConfig(ris=RisConfig(side=0)))
    assert (build_radio_map(EnvConfig()).direct == without.direct).all()


@given(st.integers(-5, 5))
@settings(max_examples=10)
def test_phases_are_periodic(turns):
    tables = build_radio_map(EnvConfig(ris=RisConfig(side=4, subsurfaces=2, bits=1)))
    turned = dataclasses.replace(
        tables, settings=np.exp(1j * (np.angle(tables.settings) + 2 * np.pi * turns))
    )
    cells = np.array(CELLS)
    for action in range(4):
        expected = tables.channel(cells, np.array(action))
        assert turned.channel(cells, np.array(action)) == pytest.approx(expected, rel=1e-9)


def test_each_subsurface_turns_its_own_part():
    tables = dataclasses.replace(
        build_radio_map(EnvConfig(ris=RisConfig(side=4, subsurfaces=2, bits=1))),
        direct=np.array([1.0 + 0j]),
        reflected=np.array([[2.0 + 0j, 5.0 + 0j]]),
    )
    # Action 1 is digits 1 and 0: the first sub-surface takes 3 pi/2, the second pi/2.
    assert tables.channel(np.array([0]), np.array(1)) == pytest.approx([1 - 2j + 5j])


def test_each_world_gets_the_channel_of_its_own_phases():
    tables = build_radio_map(EnvConfig(ris=RisConfig(side=4, subsurfaces=2)))
    cells = np.array([[0, 100, 3599], [59, 100, 1800]])
    together = tables.channel(cells, np.array([3, 14]))
    assert (together[0] == tables.channel(cells[0], np.array(3))).all()
    assert (together[1] == tables.channel(cells[1], np.array(14))).all()


def test_a_map_seed_fixes_the_map_and_another_draws_a_new_one():
    first, again = build_radio_map(EnvConfig(map_seed=5)), build_radio_map(EnvConfig(map_seed=5))
    other = build_radio_map(EnvConfig(map_seed=6))
    assert (first.direct == again.direct).all()
    assert not np.isclose(first.direct, other.direct).any()
    assert (first.reflected == other.reflected).all()


def test_building_a_map_touches_no_global_generator():
    before, legacy = random.getstate(), np.random.get_state()  # noqa: NPY002
    build_radio_map(EnvConfig(map_seed=3))
    after = np.random.get_state()  # noqa: NPY002
    assert random.getstate() == before
    assert after[2] == legacy[2]
    assert (after[1] == legacy[1]).all()


@pytest.mark.parametrize(
    ("side", "everywhere_db", "shadow_db"), [(20, 5.5, 11.2), (30, 8.5, 16.6), (40, 11.1, 20.9)]
)
def test_the_best_of_four_phases_gains_as_much_as_the_papers_figures_need(
    side, everywhere_db, shadow_db
):
    tables = build_radio_map(EnvConfig(ris=RisConfig(side=side)))
    cells = np.arange(Floor.from_config(EnvConfig()).cells)
    best = np.max([np.abs(tables.channel(cells, np.array(a))) for a in range(4)], axis=0)
    gain_db = 20 * np.log10(best / np.abs(tables.direct))
    assert gain_db.mean() == pytest.approx(everywhere_db, abs=0.5)
    assert gain_db[~tables.direct_los].mean() == pytest.approx(shadow_db, abs=0.5)


def test_a_robot_under_the_access_point_is_never_nearer_than_half_a_metre():
    config = dataclasses.replace(
        EnvConfig(),
        walls=WallsConfig(segments=[]),
        channel=ChannelConfig(rician_k_db=300.0),
        ap=dataclasses.replace(EnvConfig().ap, position_m=[15.25, 15.25, 1.0]),
    )
    tables = build_radio_map(config)
    cell = 30 * 60 + 30
    assert tables.direct[cell] == pytest.approx(
        10 ** (-(32.4 + 17.3 * math.log10(0.5) + 20 * math.log10(2.4)) / 20)
    )
