"""The surface's responses: far and near field, independent elements; and the phase of distances."""

import cmath
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env.config import AccessPointConfig, ChannelConfig, EnvConfig, RisConfig
from env.radio.propagation import (
    array_factor,
    element_offsets_m,
    far_excess_m,
    near_excess_m,
    path_phase,
    rayleigh_response,
    wavelength_m,
)
from env.radio.radio_map import build_radio_map
from env.rendering.drawing import best_gain_db

EXCESS = {"far": far_excess_m, "near": near_excess_m}
WAVELENGTH_M = 299_792_458 / 2.4e9
AP_M, RIS_M = (15.0, 30.0, 2.0), (30.0, 7.5, 2.0)
CELLS = (0, 59, 900, 1234, 1799, 3599)


def surface(response, channel=None, **ris):
    ris = {"side": 6, **ris}
    return EnvConfig(ris=RisConfig(response=response, **ris), channel=channel or ChannelConfig())


# A literal implementation: every element has a place, Theta is a matrix.


def literal_elements(side, axis, spacing=0.5, centre=RIS_M):
    """Where each element is, row by row from the bottom up."""
    places = []
    for row in range(side):
        for column in range(side):
            along = (column - (side - 1) / 2) * spacing * WAVELENGTH_M
            up = (row - (side - 1) / 2) * spacing * WAVELENGTH_M
            x, y, z = centre
            places.append((x + along, y, z + up) if axis == "x" else (x, y + along, z + up))
    return places


def literal_path_m(response, end, element, centre=RIS_M):
    """An element's path: its exact length, or that of a plane wave at the panel's centre."""
    if response == "near":
        return math.dist(end, element)
    length = math.dist(end, centre)
    steps = zip(end, element, centre, strict=True)
    return length - sum((e - c) / length * (p - c) for e, p, c in steps)


def literal_amplitude(end, clear):
    d, f = math.log10(math.dist(end, RIS_M)), math.log10(2.4)
    los = 32.4 + 17.3 * d + 20 * f
    return 10 ** (-(los if clear else max(los, 17.3 + 38.3 * d + 24.9 * f)) / 20)


def literal_reflection(config, cell, theta, clear, phase):
    """The paper's h Theta g; ``phase`` is whether the centre's distances turn it."""
    ris, response = config.ris, config.ris.response
    at = ((cell % 60 + 0.5) * 0.5, (cell // 60 + 0.5) * 0.5, 1.0)
    wave_number = 2 * math.pi / WAVELENGTH_M
    channels = []
    for end, los in ((at, clear), (AP_M, True)):
        centre_m = 0.0 if phase else math.dist(end, RIS_M)
        lengths = [
            literal_path_m(response, end, element) - centre_m
            for element in literal_elements(ris.side, ris.axis, ris.spacing)
        ]
        turns = [cmath.exp(-1j * wave_number * length) for length in lengths]
        channels.append(literal_amplitude(end, los) * np.array(turns))
    h, g = channels
    each = np.kron(np.exp(1j * np.array(theta)), np.ones(ris.side**2 // ris.subsurfaces))
    return h @ np.diag(each) @ g


@pytest.mark.parametrize("response", ["far", "near"])
@pytest.mark.parametrize("subsurfaces", [1, 4])
@pytest.mark.parametrize(
    ("axis", "spacing", "los_phase"), [("y", 0.5, "zero"), ("x", 0.3, "distance")]
)
def test_the_response_is_that_of_elements_with_places_and_a_phase_matrix(
    response, subsurfaces, axis, spacing, los_phase
):
    channel = ChannelConfig(los_phase=los_phase)
    ris = {"axis": axis, "spacing": spacing, "subsurfaces": subsurfaces}
    config = surface(response, channel, **ris)
    tables = build_radio_map(config)
    for action in {0, 3, 4**subsurfaces // 2, 4**subsurfaces - 1}:
        theta = [(action // 4**n % 4 + 0.5) * math.pi / 2 for n in range(subsurfaces)]
        found = tables.channel(np.array(CELLS), np.array(action)) - tables.direct[list(CELLS)]
        for cell, reflection in zip(CELLS, found, strict=True):
            clear = bool(tables.ris_los[cell])
            expected = literal_reflection(config, cell, theta, clear, los_phase == "distance")
            assert reflection == pytest.approx(expected, rel=1e-6, abs=1e-12)


# Gain laws.


def factor(to_ap, to_point, response, side, axis="y", subsurfaces=1):
    offsets = element_offsets_m(side, WAVELENGTH_M / 2, axis)
    ends = np.asarray(to_ap, dtype=float), np.asarray([to_point], dtype=float)
    return array_factor(*ends, offsets, subsurfaces, WAVELENGTH_M, EXCESS[response])[0]


@given(
    st.integers(1, 20), st.floats(0.5, 30), st.floats(-20, 20), st.floats(-3, 3), st.floats(0.1, 9)
)
@settings(max_examples=40)
def test_in_the_specular_direction_far_elements_add_up_in_phase(side, away, along, up, times):
    # A mirror in the plane x = 0 turns the other two coordinates of a direction round.
    mirrored = np.array([-away, -along, -up]) * times
    found = factor([-away, along, up], mirrored, "far", side)
    assert found == pytest.approx([side**2], rel=1e-6)


@pytest.mark.parametrize("side", [4, 10, 30, 40])
def test_one_beam_width_from_the_specular_direction_nothing_is_left(side):
    """Across a panel of side half wavelengths the path then changes by one wavelength."""
    sine = 2 / side
    aside = [-math.sqrt(1 - sine**2), sine, 0.0]
    assert abs(factor([-9.0, 0.0, 0.0], aside, "far", side)[0]) < 1e-9 * side**2


@pytest.mark.parametrize("response", ["far", "near"])
def test_with_equal_phases_the_panel_is_a_mirror_with_one_narrow_beam(response):
    """Half of a half circle around a panel of 30 x 30 gets less than a thousandth of M^2."""
    angle = np.linspace(-1.5, 1.5, 301)
    circle = 500.0 * np.stack([-np.cos(angle), np.sin(angle), np.zeros(301)], axis=-1)
    offsets = element_offsets_m(30, WAVELENGTH_M / 2, "y")
    ap = np.array([-500.0, 0.0, 0.0])
    found = array_factor(ap, circle, offsets, 1, WAVELENGTH_M, EXCESS[response])
    power = np.abs(found[:, 0]) ** 2 / 900**2
    assert power.argmax() == 150
    assert np.median(power) < 1e-3
    assert np.mean(power > 0.5) < 0.03


@given(
    st.integers(1, 12),
    st.sampled_from(["far", "near"]),
    st.tuples(st.floats(-30, -0.6), st.floats(-30, 30), st.floats(-2, 2)),
    st.tuples(st.floats(-30, -0.6), st.floats(-30, 30), st.floats(-2, 2)),
)
def test_no_geometry_reflects_more_than_elements_in_phase(side, response, to_ap, to_point):
    parts = factor(to_ap, to_point, response, side, subsurfaces=side)
    assert (np.abs(parts) <= side * (1 + 1e-9)).all()
    assert parts.sum() == pytest.approx(factor(to_ap, to_point, response, side)[0])


def test_one_element_reflects_alike_under_every_geometry():
    tables = [build_radio_map(surface(name, side=1)) for name in ("coherent", "far", "near")]
    for other in tables[1:]:
        np.testing.assert_allclose(other.reflected, tables[0].reflected, rtol=1e-9)


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-0.1, 0.1))
@settings(max_examples=30)
def test_far_away_the_near_field_becomes_the_far_field(first, second, rise):
    """The error is about k size^2 / (2 d) a link, so it falls as the distance grows."""
    errors = []
    for distance_m in (30.0, 1e3, 1e5):
        ends = [distance_m * np.array([-math.cos(a), math.sin(a), rise]) for a in (first, second)]
        exact, plane = (factor(*ends, name, 20)[0] for name in ("near", "far"))  # type: ignore[call-arg]
        errors.append(abs(exact - plane) / 400)
    assert errors[1] < 0.05
    assert errors[2] < 5e-4


def test_the_exact_distance_is_kept_where_a_difference_would_lose_it():
    offsets = element_offsets_m(2, 0.1, "y")
    found = near_excess_m(np.array([[-1e12, 0.0, 0.0]]), offsets)
    assert found[0] == pytest.approx([0.005 / 2e12] * 4, rel=1e-6)


def test_at_the_panels_centre_itself_the_response_is_finite():
    tables = [
        build_radio_map(
            EnvConfig(
                ris=RisConfig(side=3, response=response, position_m=[29.75, 7.75, 1.0]),
                ap=AccessPointConfig(position_m=[29.75, 7.75, 1.0]),
            )
        )
        for response in ("far", "near")
    ]
    assert all(np.isfinite(table.reflected).all() for table in tables)


# The panel.


def test_a_panel_is_vertical_centred_and_dealt_out_row_by_row_from_the_bottom_up():
    along_y, along_x = element_offsets_m(3, 0.1, "y"), element_offsets_m(3, 0.1, "x")
    assert along_y.shape == (9, 3)
    assert along_y[0] == pytest.approx([0, -0.1, -0.1])
    assert along_y[1] == pytest.approx([0, 0, -0.1])
    assert along_y[3] == pytest.approx([0, -0.1, 0])
    assert along_y[8] == pytest.approx([0, 0.1, 0.1])
    assert along_y.mean(axis=0) == pytest.approx([0, 0, 0])
    np.testing.assert_array_equal(along_x, along_y[:, [1, 0, 2]])


def test_the_wavelength_is_that_of_the_carrier():
    assert wavelength_m(2.4) == pytest.approx(0.124914, abs=1e-6)
    assert wavelength_m(0.299792458) == pytest.approx(1.0)


@pytest.mark.parametrize("response", ["far", "near"])
def test_the_chunks_of_a_large_panel_do_not_show(response, monkeypatch):
    config = surface(response, side=12, subsurfaces=3)
    whole = build_radio_map(config).reflected
    monkeypatch.setattr("env.radio.propagation.MAX_AT_ONCE", 1000)
    np.testing.assert_allclose(build_radio_map(config).reflected, whole, rtol=1e-9, atol=1e-15)


# Independent elements.


@pytest.mark.parametrize(("elements", "subsurfaces"), [(1, 1), (16, 1), (64, 4), (400, 1)])
def test_independent_elements_reflect_in_proportion_to_their_number(elements, subsurfaces):
    generator = np.random.default_rng(0)
    outgoing = np.full(20, 0.5)
    drawn = np.stack(
        [
            rayleigh_response(0.1, outgoing, elements, subsurfaces, generator)
            for _ in range(4000 // subsurfaces)
        ]
    )
    power = np.abs(drawn / (0.1 * 0.5)) ** 2
    assert power.mean() == pytest.approx(elements / subsurfaces, rel=0.06)
    assert abs(drawn.mean()) / (0.1 * 0.5) < 0.03 * math.sqrt(elements / subsurfaces)


@pytest.mark.parametrize("elements", [1, 2, 9])
def test_drawing_the_sum_at_once_has_the_law_of_drawing_every_element(elements):
    generator = np.random.default_rng(1)
    draws = 40_000
    parts = np.random.default_rng(2).standard_normal((3, 2, draws, elements)) * math.sqrt(0.5)
    g, *others = parts[:, 0] + 1j * parts[:, 1]
    literal = np.array([np.abs((h * g).sum(-1)) ** 2 for h in others])
    # Sub-surfaces are independent: as many of them are as many draws.
    drawn = rayleigh_response(1.0, np.ones(2), draws * elements, draws, generator)
    at_once = np.abs(drawn) ** 2
    for power in (literal, at_once):
        assert power.mean() == pytest.approx(elements, rel=0.03)
        # The common g makes powers at two points move together: E a b = M^2 + M.
        assert (power[0] * power[1]).mean() == pytest.approx(elements**2 + elements, rel=0.1)
    quantiles = [np.quantile(power, (0.1, 0.5, 0.9)) for power in (literal, at_once)]
    assert quantiles[1] == pytest.approx(quantiles[0], rel=0.04)


def test_independent_elements_are_drawn_from_the_map_seed_and_leave_the_direct_channel():
    first, again = (build_radio_map(surface("rayleigh")) for _ in range(2))
    other = build_radio_map(EnvConfig(map_seed=1, ris=RisConfig(side=6, response="rayleigh")))
    assert (first.reflected == again.reflected).all()
    assert (first.reflected != other.reflected).all()
    assert (first.direct == build_radio_map(EnvConfig()).direct).all()


# All responses.


@pytest.mark.parametrize("response", ["coherent", "far", "near", "rayleigh"])
def test_no_surface_is_exactly_the_direct_channel_under_every_response(response):
    for los_phase in ("zero", "distance"):
        channel = ChannelConfig(los_phase=los_phase)
        tables = build_radio_map(surface(response, channel, side=0, subsurfaces=2))
        found = tables.channel(np.arange(3600), np.array(7))
        assert (tables.reflected == 0).all()
        assert (found == tables.direct).all()


@pytest.mark.parametrize("response", ["far", "near", "rayleigh"])
def test_a_whole_turn_of_the_phases_changes_nothing(response):
    tables = build_radio_map(surface(response, subsurfaces=4))
    angle = np.angle(tables.settings)
    for turns in (-2, 1, 3):
        turned = np.exp(1j * (angle + 2 * np.pi * turns))
        np.testing.assert_allclose(
            tables.reflected @ turned.T, tables.reflected @ tables.settings.T, rtol=1e-9, atol=1e-15
        )


@pytest.mark.parametrize(
    ("response", "side", "subsurfaces", "everywhere_db", "shadow_db"),
    [
        ("far", 30, 1, 0.2, 0.4),
        ("near", 30, 1, 0.4, 0.8),
        ("rayleigh", 30, 1, 0.7, 1.5),
        ("far", 30, 4, 0.7, 1.4),
        ("near", 30, 4, 0.7, 1.5),
        ("rayleigh", 30, 4, 1.3, 2.7),
        ("near", 40, 1, 0.6, 1.2),
    ],
)
def test_the_best_phases_gain_what_the_assumptions_say(
    response, side, subsurfaces, everywhere_db, shadow_db
):
    tables = build_radio_map(surface(response, side=side, subsurfaces=subsurfaces))
    gain_db = best_gain_db(tables) - 20 * np.log10(np.abs(tables.direct))
    assert gain_db.mean() == pytest.approx(everywhere_db, abs=0.1)
    assert gain_db[~tables.direct_los].mean() == pytest.approx(shadow_db, abs=0.1)


# The phase of distances.


def test_a_path_turns_once_in_a_wavelength():
    found = path_phase(np.array([0.0, 0.25, 0.5, 1.0, 7.0]), 1.0)
    assert found == pytest.approx([1, -1j, -1, 1, 1])


@pytest.mark.parametrize("response", ["coherent", "far", "near", "rayleigh"])
def test_the_phase_of_distances_turns_both_paths_and_changes_no_amplitude(response):
    zero = build_radio_map(surface(response, subsurfaces=2))
    turned = build_radio_map(surface(response, ChannelConfig(los_phase="distance"), subsurfaces=2))
    np.testing.assert_allclose(np.abs(turned.direct), np.abs(zero.direct))
    for cell in CELLS:
        at = ((cell % 60 + 0.5) * 0.5, (cell // 60 + 0.5) * 0.5, 1.0)
        straight = cmath.exp(-2j * math.pi * math.dist(at, AP_M) / WAVELENGTH_M)
        way = math.dist(at, RIS_M) + math.dist(RIS_M, AP_M)
        around = cmath.exp(-2j * math.pi * way / WAVELENGTH_M)
        assert turned.direct[cell] == pytest.approx(zero.direct[cell] * straight, rel=1e-6)
        assert turned.reflected[cell] == pytest.approx(zero.reflected[cell] * around, rel=1e-6)
