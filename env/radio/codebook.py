"""Beams for a surface whose elements are set one by one: each serves a sector of the floor.

With true steering vectors, equal phases make a mirror with one narrow beam. A codebook keeps the
AP's choice small and yet sets every element: action ``a`` is the beam of sector ``a``. Its phases
are computed from places alone, without the channels' fading (``docs/ris.md``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from env.arrays import Complexes, Floats, Ints
from env.config import EnvConfig
from env.geometry.floor import Floor
from env.radio.propagation import (
    MAX_AT_ONCE,
    Excess,
    element_offsets_m,
    far_excess_m,
    near_excess_m,
    path_phase,
    phases,
    wavelength_m,
)

ITERATIONS = 3
"""Rounds of spreading a beam over its sector."""


class Panel(NamedTuple):
    """A surface's elements and the AP that lights them, lengths in m.

    Attributes:
        ap_m: from the panel's centre to the AP, shape (3,).
        offsets_m: from the centre to each element, shape (M, 3).
        wavelength_m: the carrier's wavelength.
        excess: ``propagation.far_excess_m`` or ``propagation.near_excess_m``.
    """

    ap_m: Floats
    offsets_m: Floats
    wavelength_m: float
    excess: Excess

    @classmethod
    def from_config(cls, config: EnvConfig) -> Panel:
        """The surface of a configuration with ``ris.response`` far or near."""
        ris, length_m = config.ris, wavelength_m(config.channel.frequency_ghz)
        return cls(
            np.asarray(config.ap.position_m) - np.asarray(ris.position_m),
            element_offsets_m(ris.side, ris.spacing * length_m, ris.axis),
            length_m,
            far_excess_m if ris.response == "far" else near_excess_m,
        )

    def waves(self, points_m: Floats) -> Complexes:
        """e^{-jk (path over the element - path over the centre)}, shape (P, M).

        Points are offsets from the panel's centre in m, shape (P, 3).
        """
        feed = self.excess(self.ap_m[None], self.offsets_m)
        return path_phase(feed + self.excess(points_m, self.offsets_m), self.wavelength_m)


def sector_of_cells(floor: Floor, columns: int, rows: int) -> Ints:
    """The sector that each cell belongs to, row by row from the bottom up, shape (cells,)."""
    row, column = np.divmod(np.arange(floor.cells), floor.columns)
    return np.asarray((row * rows // floor.rows) * columns + column * columns // floor.columns)


def focus(waves: Complexes) -> Floats:
    """Phases theta_m in rad, (M,), that serve all points of a sector: alternating optimisation.

    Begins with the focus on the middle point. Each round takes the phase that the summed wave has
    at each point as the one to aim for, and then aligns every element with all points' aims: the
    mean over the points of the summed wave's size never falls. Waves have shape (P, M).
    """
    theta = np.conj(waves[len(waves) // 2])
    for _ in range(ITERATIONS):
        theta = _align(waves, theta)
    return np.asarray(np.angle(theta))


def _align(waves: Complexes, theta: Complexes) -> Complexes:
    """One round of ``focus``: factors e^{j theta_m}, shape (M,)."""
    total = waves @ theta
    return np.asarray(np.exp(1j * np.angle(np.conj(waves).T @ np.exp(1j * np.angle(total)))))


def quantise(theta: Floats, bits: int) -> Ints:
    """The index of the nearest phase of ``propagation.phases``, for phases in rad, same shape."""
    count = 2**bits
    return np.asarray(np.floor(theta / (2.0 * np.pi / count)).astype(np.int64) % count)


def beams(panel: Panel, points_m: Floats, sector: Ints, bits: int) -> Ints:
    """The phase index of every element in every beam, shape (sectors, M).

    Args:
        panel: the surface.
        points_m: from the panel's centre to each cell, shape (cells, 3).
        sector: the sector of each cell, shape (cells,); each has one at least.
        bits: b, with N_R = 2^b.
    """
    count, elements = int(sector.max()) + 1, len(panel.offsets_m)
    index = np.empty((count, elements), dtype=np.int64)
    most = max(1, 8 * MAX_AT_ONCE // elements)
    for number in range(count):
        members = np.flatnonzero(sector == number)
        apart = -(-len(members) // most)
        index[number] = quantise(focus(panel.waves(points_m[members[apart // 2 :: apart]])), bits)
    return index


def factors(panel: Panel, points_m: Floats, index: Ints, bits: int) -> Complexes:
    """The elements' waves summed under each beam, M at most in size; c is |g| |h| times that.

    Arguments are as of ``beams``, which gives ``index``.

    Returns:
        Factors, shape (cells, beams).
    """
    theta = np.exp(1j * phases(bits))[index].T
    table = np.empty((len(points_m), len(index)), dtype=np.complex128)
    at_once = max(1, MAX_AT_ONCE // len(panel.offsets_m))
    for first in range(0, len(points_m), at_once):
        table[first : first + at_once] = panel.waves(points_m[first : first + at_once]) @ theta
    return table
