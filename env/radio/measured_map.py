"""A radio map from what robots measured: gains that they report, fused by the access point.

The AP knows the phase setting of every slot and hbar at the cells that were passed (it is in its
state, Eq. (6)); of the surface it knows nothing but the gains. With one sub-surface and d = c/hbar,
|h|^2 / |hbar|^2 - 1 = |d|^2 + 2 Re(e^{j theta} d): linear in |d|^2, Re d and Im d, so three phases
measured in a cell give c. Other cells lean on their neighbours.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from env.arrays import Bools, Complexes, Floats, Ints
from env.config import RisConfig
from env.radio.radio_map import RadioMap

REPORT_BYTES = 8
"""A report on the air: the cell as int32 and the gain as float32; the AP knows the phase."""

ENOUGH = 3
"""Different phases in a cell that give its c alone."""

NEARNESS = -4
"""The power of the distance by which known cells count for another; -4 makes the near ones win."""

MAX_PAIRS = 2**20
"""Pairs of cells whose distances are held at once, 8 MB."""


class Reports(NamedTuple):
    """What robots measured, and what the AP knew then; R reports.

    Attributes:
        cell: where, shape (R,).
        phase: the AP's action, shape (R,).
        gain: |h|^2 as measured, shape (R,).
        direct: hbar of the cell, from the AP's state, shape (R,).
    """

    cell: Ints
    phase: Ints
    gain: Floats
    direct: Complexes


def refuse(ris: RisConfig) -> None:
    """Finds before anything is measured that the fit does not know such a surface.

    Raises:
        ValueError: there are several sub-surfaces, beams, or fewer than three phases.
    """
    if ris.action == "codebook":
        raise ValueError("env.ris.action=codebook: allowed is phases where a map is measured")
    if ris.subsurfaces > 1:
        raise ValueError(
            f"env.ris.subsurfaces={ris.subsurfaces}: allowed is 1 where a map is measured"
        )
    if 2**ris.bits < ENOUGH:
        raise ValueError(
            f"env.ris.bits={ris.bits}: allowed is at least 2 where a map is measured: a cell's"
            " channel takes three phases"
        )


def fuse(reports: Reports, centres_m: Floats, settings: Complexes) -> RadioMap:
    """The radio map that reports give.

    * hbar: as known where somebody passed; elsewhere the neighbours' mean power, phase 0.
    * c: the least-squares fit where three phases or more were measured. Elsewhere |c| and the
      direction of c are the neighbours' means (0 where no cell has three phases), and where one or
      two phases were measured c moves from there to the nearest value that agrees with them.

    Repeated measurements are averaged in dB. Neighbours' means weigh with the distance to the power
    ``NEARNESS``, walls or not.

    Args:
        reports: at least one.
        centres_m: of all cells, shape (cells, 2).
        settings: e^{j theta} of each action of the AP, shape (A, 1).

    Returns:
        The map, on which a scenario can be built. Lines of sight are unknown, and all False.
    """
    direct = _direct(reports, centres_m)
    pairs, where = np.unique(reports.cell * len(settings) + reports.phase, return_inverse=True)
    cell, phase = np.divmod(pairs, len(settings))
    gain = np.exp(np.bincount(where, np.log(reports.gain)) / np.bincount(where))
    turn, number = settings[phase, 0], np.bincount(cell, minlength=len(centres_m))
    reflected = _fitted(cell, turn, gain, direct, number >= ENOUGH)
    _lean(reflected, number >= ENOUGH, centres_m)
    _agree(reflected, cell, turn, gain, direct, number)
    return RadioMap(
        direct=direct,
        reflected=reflected[:, None],
        settings=settings,
        direct_db=(20.0 * np.log10(np.abs(direct))).astype(np.float32),
        direct_los=np.zeros(len(direct), dtype=bool),
        ris_los=np.zeros(len(direct), dtype=bool),
    )


def _direct(reports: Reports, centres_m: Floats) -> Complexes:
    """Hbar of every cell, shape (cells,)."""
    direct = np.zeros(len(centres_m), dtype=np.complex128)
    direct[reports.cell] = reports.direct
    known = np.bincount(reports.cell, minlength=len(centres_m)) > 0
    power = np.abs(direct[known]) ** 2
    direct[~known] = np.sqrt(_near(centres_m, known, power[:, None])[:, 0])
    return direct


def _fitted(
    cell: Ints, turn: Complexes, gain: Floats, direct: Complexes, enough: Bools
) -> Complexes:
    """C by least squares in the cells with enough phases, 0 elsewhere, shape (cells,)."""
    row = np.column_stack([np.ones(len(turn)), 2.0 * turn.real, -2.0 * turn.imag])
    excess = gain / np.abs(direct[cell]) ** 2 - 1.0
    square, side = np.zeros((len(direct), 3, 3)), np.zeros((len(direct), 3, 1))
    np.add.at(square, cell, row[:, :, None] * row[:, None, :])
    np.add.at(side, cell, (row * excess[:, None])[..., None])
    reflected = np.zeros(len(direct), dtype=np.complex128)
    found = np.linalg.solve(square[enough], side[enough])[..., 0]
    reflected[enough] = direct[enough] * (found[:, 1] + 1j * found[:, 2])
    return reflected


def _lean(reflected: Complexes, known: Bools, centres_m: Floats) -> None:
    """Puts the neighbours' mean |c|, in their mean direction, where c is not known."""
    if not known.any():
        return
    size, angle = np.abs(reflected[known]), np.angle(reflected[known])
    parts = np.column_stack([size, np.cos(angle), np.sin(angle)])
    size, along, across = _near(centres_m, known, parts).T
    reflected[~known] = size * np.exp(1j * np.arctan2(across, along))


def _agree(
    reflected: Complexes, cell: Ints, turn: Complexes, gain: Floats, direct: Complexes, number: Ints
) -> None:
    """Moves c of cells with one or two phases to the nearest value that gives the gains there.

    A gain puts c on a circle of radius |h| about -hbar e^{-j theta}. Two meet in two points; where
    noise keeps them apart, the point between them is taken.
    """
    middle, radius = -direct[cell] / turn, np.sqrt(gain)
    first = np.searchsorted(cell, np.arange(len(number)))  # pairs are sorted by cell
    at = first[number == 1]
    turned = np.exp(1j * np.angle(reflected[cell[at]] - middle[at]))
    reflected[cell[at]] = middle[at] + radius[at] * turned
    at = first[number == 2]
    line = middle[at + 1] - middle[at]
    apart = np.abs(line)
    along = (apart**2 + radius[at] ** 2 - radius[at + 1] ** 2) / (2.0 * apart)
    across = 1j * np.sqrt(np.maximum(radius[at] ** 2 - along**2, 0.0))
    either = middle[at] + line / apart * (along + np.array([[1.0], [-1.0]]) * across)
    nearer = np.abs(either - reflected[cell[at]]).argmin(axis=0)
    reflected[cell[at]] = either[nearer, np.arange(len(at))]


def _near(centres_m: Floats, known: Bools, values: Floats) -> Floats:
    """Means of the known cells' values, shape (known, V), at the others, by their distances."""
    sources, targets = centres_m[known], centres_m[~known]
    found = np.empty((len(targets), values.shape[1]))
    at_once = max(1, MAX_PAIRS // len(sources))
    for first in range(0, len(targets), at_once):
        apart_m = targets[first : first + at_once, None] - sources
        weight = np.linalg.norm(apart_m, axis=-1) ** NEARNESS
        found[first : first + at_once] = weight @ values / weight.sum(axis=-1, keepdims=True)
    return found
