"""The measured map: by hand, in cells with few phases or none, and whole."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from env.checks import checked_config
from env.config import RisConfig
from env.geometry.floor import Floor
from env.radio.measured_map import Reports, fuse, refuse
from env.radio.radio_map import RadioMap, build_radio_map

QUARTERS = np.array([[1.0], [1j], [-1.0], [-1j]])
"""Phase settings of 0, 90, 180 and 270 degrees."""


def reported(*rows: tuple[int, int, float, complex]) -> Reports:
    """Reports from (cell, phase, gain, direct)."""
    cell, phase, gain, direct = zip(*rows, strict=True)
    return Reports(np.array(cell), np.array(phase), np.array(gain), np.array(direct))


def in_a_row(cells: int) -> NDArray[np.float64]:
    return np.column_stack([np.arange(cells, dtype=np.float64), np.zeros(cells)])


def test_three_phases_give_a_cells_channel_by_hand() -> None:
    # hbar = 2, c = 1 + j: |3 + j|^2 = 10, |2 + j - 1|^2 = 2, |2 - 1 - j|^2 = 2
    fused = fuse(reported((0, 0, 10, 2), (0, 1, 2, 2), (0, 2, 2, 2)), in_a_row(1), QUARTERS)
    assert fused.direct == pytest.approx(2)
    assert fused.reflected == pytest.approx(1 + 1j)
    # and of the phase that nobody measured: |2 - j + 1|^2 = 10
    assert fused.gain(np.array([0]), np.array(3)) == pytest.approx(10)


def test_repeated_measurements_are_averaged_in_db() -> None:
    rows = ((0, 0, 5, 2), (0, 0, 20, 2), (0, 1, 2, 2), (0, 2, 2, 2))
    assert fuse(reported(*rows), in_a_row(1), QUARTERS).reflected == pytest.approx(1 + 1j)


def test_four_phases_that_disagree_are_fitted_by_least_squares() -> None:
    rows = [(0, phase, gain, 1.0 + 0j) for phase, gain in enumerate((5.0, 2.0, 1.0, 2.0))]
    # |h|^2 - 1 = b + 2 Re(c) cos - 2 Im(c) sin: Re(c) = (5 - 1) / 4, Im(c) = (2 - 2) / 4
    assert fuse(reported(*rows), in_a_row(1), QUARTERS).reflected == pytest.approx(1)


def test_cells_that_nobody_passed_lean_on_near_ones() -> None:
    rows = [(0, phase, gain, 2.0 + 0j) for phase, gain in enumerate((10.0, 2.0, 2.0))]
    rows += [(2, phase, gain, 2j) for phase, gain in enumerate((9.0 + 16.0, 9.0, 1.0))]
    # In cell 2 hbar = 2j and c = 3 + 2j: |3 + 4j|^2, |2j + 3j - 2|^2 = 29, |-3|^2 = 9
    rows[4], rows[5] = (2, 1, 29.0, 2j), (2, 2, 9.0, 2j)
    fused = fuse(reported(*rows), in_a_row(3), QUARTERS)
    assert fused.reflected[2, 0] == pytest.approx(3 + 2j)
    assert fused.direct[1] == pytest.approx(2)  # the mean power, phase 0
    size = (np.sqrt(2) + np.sqrt(13)) / 2
    angle = (np.angle(1 + 1j) + np.angle(3 + 2j)) / 2
    assert fused.reflected[1, 0] == pytest.approx(size * np.exp(1j * angle))


def test_one_phase_moves_the_channel_no_farther_than_it_must() -> None:
    rows = [(0, phase, gain, 2.0 + 0j) for phase, gain in enumerate((10.0, 2.0, 2.0))]
    fused = fuse(reported(*rows, (1, 0, 40.0, 2.0)), in_a_row(2), QUARTERS)
    # The neighbour's c gives h = 3 + j, of power 10; twice that has the power measured.
    assert fused.reflected[1, 0] == pytest.approx(4 + 2j)


@pytest.mark.parametrize("phases", [(0,), (0, 1), (1, 3), (2, 3)])
def test_few_phases_without_a_fit_anywhere_still_agree_with_what_was_measured(
    phases: tuple[int, ...],
) -> None:
    direct, reflected = 2.0 + 0j, 0.8 + 0.4j
    gains = [abs(direct + QUARTERS[phase, 0] * reflected) ** 2 for phase in phases]
    rows = [(0, phase, gain, direct) for phase, gain in zip(phases, gains, strict=True)]
    fused = fuse(reported(*rows), in_a_row(2), QUARTERS)
    found = [fused.gain(np.array([0]), np.array(phase))[0] for phase in phases]
    assert found == pytest.approx(gains)
    assert fused.reflected[1] == 0


def test_of_two_values_that_fit_two_phases_the_nearer_to_the_neighbours_is_taken() -> None:
    # Under 0 and 180 degrees c = 1 + j and c = 1 - j give the same gains, 10 and 2.
    three = [(0, phase, gain, 2.0 + 0j) for phase, gain in enumerate((10.0, 10.0, 2.0))]
    fused = fuse(reported(*three, (1, 0, 10, 2), (1, 2, 2, 2)), in_a_row(2), QUARTERS)
    assert fused.reflected[:, 0] == pytest.approx([1 - 1j, 1 - 1j])


def test_noise_that_keeps_two_phases_from_agreeing_leaves_a_finite_map() -> None:
    fused = fuse(reported((0, 0, 0.01, 2), (0, 2, 0.01, 2)), in_a_row(1), QUARTERS)
    assert fused.reflected[0] == pytest.approx(0)  # no c is within 0.1 of both -2 and 2


def everything(true: RadioMap) -> Reports:
    """Each cell reported under every phase."""
    settings = len(true.settings)
    cell, phase = np.divmod(np.arange(len(true.direct) * settings), settings)
    return Reports(cell, phase, true.gain(cell[:, None], phase)[:, 0], true.direct[cell])


@pytest.mark.parametrize(
    "keys",
    [
        {},
        {"channel": {"los_phase": "distance"}},
        {"ris": {"side": 0}},
        {"ris": {"bits": 3, "response": "far"}},
        {"ris": {"response": "rayleigh"}},
    ],
)
def test_with_every_cell_and_phase_measured_the_map_is_the_true_one(keys: dict[str, Any]) -> None:
    config = checked_config(keys)
    true = build_radio_map(config)
    fused = fuse(everything(true), Floor.from_config(config).centres(), true.settings)
    np.testing.assert_array_equal(fused.direct, true.direct)
    np.testing.assert_array_equal(fused.direct_db, true.direct_db)
    np.testing.assert_allclose(fused.reflected, true.reflected, rtol=1e-9, atol=1e-15)
    cells, actions = np.arange(len(true.direct))[None], np.arange(len(true.settings))
    np.testing.assert_allclose(fused.gain(cells, actions), true.gain(cells, actions), rtol=1e-9)


@pytest.mark.parametrize(
    ("ris", "said"),
    [
        (RisConfig(subsurfaces=2), r"env\.ris\.subsurfaces=2: allowed is 1"),
        (RisConfig(bits=1), r"env\.ris\.bits=1: allowed is at least 2"),
        (RisConfig(response="far", action="codebook"), r"env\.ris\.action=codebook: allowed is"),
    ],
)
def test_a_surface_that_the_fit_does_not_know_is_refused(ris: RisConfig, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        refuse(ris)
    refuse(RisConfig())
