"""Path loss, fading and the surface's response."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env.radio.propagation import (
    amplitude,
    coherent_response,
    path_loss_db,
    phase_settings,
    phases,
    small_scale_fading,
)

DRAWS = 200_000


@pytest.mark.parametrize(
    ("distance_m", "frequency_ghz", "los", "loss_db"),
    [
        (1.0, 1.0, True, 32.4),
        (10.0, 1.0, True, 49.7),
        (10.0, 2.4, True, 57.304225),  # 32.4 + 17.3 + 20 log10 2.4
        (100.0, 1.0, True, 67.0),
        (10.0, 1.0, False, 55.6),
        (10.0, 2.4, False, 65.067260),  # 17.3 + 38.3 + 24.9 log10 2.4
        (100.0, 1.0, False, 93.9),
        (1.0, 1.0, False, 32.4),  # close by the clear loss is the larger
        (1.0, 2.4, False, 40.004225),
    ],
)
def test_path_loss_is_that_of_the_indoor_hotspot(distance_m, frequency_ghz, los, loss_db):
    found = path_loss_db(np.array([distance_m]), frequency_ghz, np.array([los]))
    assert found[0] == pytest.approx(loss_db, abs=1e-5)


@given(st.floats(0.5, 100), st.floats(0.5, 100), st.floats(0.5, 60))
def test_loss_grows_with_distance_and_behind_walls(first_m, second_m, frequency_ghz):
    near, far = sorted((first_m, second_m))
    for los in (True, False):
        loss = path_loss_db(np.array([near, far]), frequency_ghz, los)
        assert loss[0] <= loss[1]
    clear = path_loss_db(np.array([near]), frequency_ghz, True)
    assert path_loss_db(np.array([near]), frequency_ghz, False) >= clear


def test_twenty_decibels_are_a_tenth_of_the_amplitude():
    assert amplitude(np.array([0.0, 20.0, 60.0])) == pytest.approx([1.0, 0.1, 0.001])


@pytest.mark.parametrize(("los", "k_db"), [(True, 7.0), (True, -3.0), (True, 20.0), (False, 7.0)])
def test_fading_has_unit_mean_power(los, k_db):
    fading = small_scale_fading(np.full(DRAWS, los), k_db, np.random.default_rng(1))
    assert np.mean(np.abs(fading) ** 2) == pytest.approx(1.0, abs=0.012)


def test_the_mean_of_rician_fading_is_its_clear_part_at_phase_zero():
    fading = small_scale_fading(np.ones(DRAWS, dtype=bool), 7.0, np.random.default_rng(2))
    k = 10**0.7
    assert fading.mean() == pytest.approx(math.sqrt(k / (k + 1)), abs=0.005)
    assert np.var(fading) == pytest.approx(1 / (k + 1), rel=0.02)


def test_rayleigh_fading_has_no_preferred_phase_and_exponential_power():
    fading = small_scale_fading(np.zeros(DRAWS, dtype=bool), 7.0, np.random.default_rng(3))
    assert abs(fading.mean()) < 0.01
    assert np.mean(np.abs(fading) ** 2 > 1.0) == pytest.approx(math.exp(-1), abs=0.005)
    assert fading.real.var() == pytest.approx(0.5, rel=0.02)
    assert fading.imag.var() == pytest.approx(0.5, rel=0.02)


def test_a_walls_shadow_takes_nothing_from_the_fading_of_clear_cells():
    los = np.array([True, False, True, False])
    mixed = small_scale_fading(los, 7.0, np.random.default_rng(4))
    clear = small_scale_fading(np.ones(4, dtype=bool), 7.0, np.random.default_rng(4))
    assert (mixed[los] == clear[los]).all()
    assert (mixed[~los] != clear[~los]).all()


@given(st.integers(1, 40), st.integers(1, 5), st.floats(1e-6, 1.0), st.floats(1e-6, 1.0))
def test_the_reflected_power_grows_with_the_square_of_the_elements(side, times, incoming, outgoing):
    at = np.array([outgoing])
    one = coherent_response(incoming, at, side**2, 1)
    more = coherent_response(incoming, at, (times * side) ** 2, 1)
    assert np.abs(more) ** 2 == pytest.approx(times**4 * np.abs(one) ** 2)


@given(st.sampled_from([(4, 1), (4, 2), (16, 4), (36, 6), (900, 5)]), st.floats(1e-6, 1.0))
def test_subsurfaces_share_the_elements_and_add_up_to_the_whole(case, outgoing):
    elements, subsurfaces = case
    parts = coherent_response(0.5, np.array([outgoing]), elements, subsurfaces)
    assert parts.shape == (1, subsurfaces)
    assert parts.sum() == pytest.approx(elements * 0.5 * outgoing)
    assert (parts == parts[0, 0]).all()


def test_no_elements_reflect_nothing():
    assert (coherent_response(0.5, np.array([0.1, 0.2]), 0, 3) == 0).all()


def test_the_phases_are_the_papers_odd_half_steps():
    pi = math.pi
    assert phases(1) == pytest.approx([pi / 2, 3 * pi / 2])
    assert phases(2) == pytest.approx([pi / 4, 3 * pi / 4, 5 * pi / 4, 7 * pi / 4])


@given(st.integers(1, 10))
def test_the_phases_divide_the_circle_evenly(bits):
    theta = phases(bits)
    assert len(theta) == 2**bits
    assert theta[0] == pytest.approx(math.pi / 2**bits)
    assert np.diff(theta) == pytest.approx(2 * math.pi / 2**bits)
    assert theta[-1] < 2 * math.pi


@given(st.integers(1, 3), st.integers(1, 4))
@settings(max_examples=20)
def test_the_digits_of_an_action_are_its_phases_the_first_subsurface_last(bits, subsurfaces):
    count = 2**bits
    found = phase_settings(bits, subsurfaces)
    assert found.shape == (count**subsurfaces, subsurfaces)
    for action, factors in enumerate(found):
        rest = action
        for factor in factors:
            rest, digit = divmod(rest, count)
            theta = (digit + 0.5) * 2 * math.pi / count
            assert factor == pytest.approx(complex(math.cos(theta), math.sin(theta)))
        assert rest == 0


def test_one_action_of_three_subsurfaces_by_hand():
    # 6 is 1 1 0 in base 2: the first sub-surface takes pi/2, the others 3 pi/2.
    assert phase_settings(1, 3)[6] == pytest.approx([1j, -1j, -1j])
