"""Path loss, fading and the RIS's response: pure functions of distances and generators."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from env.arrays import Bools, Complexes, Floats

SPEED_OF_LIGHT_MPS = 299_792_458.0
MAX_AT_ONCE = 2**17
"""Element-point pairs that ``array_factor`` holds at a time, about 4 MB."""

_TINY_M = 1e-9  # keeps directions finite at the panel's centre itself


def path_loss_db(distance_m: Floats, frequency_ghz: float, los: Bools | bool) -> Floats:
    """Path loss in dB of the indoor hotspot, 3GPP TR 38.901 Table 7.4.1-1.

    Args:
        distance_m: 3-D distance in m, any shape, above 0.
        frequency_ghz: carrier frequency in GHz.
        los: whether the link is in line of sight, broadcast with ``distance_m``.
    """
    log_d, log_f = np.log10(distance_m), np.log10(frequency_ghz)
    clear = 32.4 + 17.3 * log_d + 20.0 * log_f
    blocked = np.maximum(clear, 17.3 + 38.3 * log_d + 24.9 * log_f)
    return np.asarray(np.where(los, clear, blocked))


def amplitude(loss_db: Floats) -> Floats:
    """The amplitude gain of a link with a given loss in dB, same shape."""
    return np.asarray(10.0 ** (-loss_db / 20.0))


def wavelength_m(frequency_ghz: float) -> float:
    """The wavelength in m of a carrier in GHz."""
    return SPEED_OF_LIGHT_MPS / (frequency_ghz * 1e9)


def path_phase(distance_m: Floats, wavelength_m: float) -> Complexes:
    """e^{-jkd} of paths of a given length in m, same shape."""
    angle = -2.0 * np.pi * (distance_m / wavelength_m)
    turn = np.empty(np.shape(angle), dtype=np.complex128)
    np.cos(angle, out=turn.real)  # and the sine: quicker than the complex exponential
    np.sin(angle, out=turn.imag)
    return turn


def small_scale_fading(los: Bools, rician_k_db: float, generator: np.random.Generator) -> Complexes:
    """Fading of unit mean power, same shape: Rician in line of sight, Rayleigh out of it.

    The line-of-sight part has phase zero (``docs/assumptions.md``, C-PHASE).

    Args:
        los: whether each link is in line of sight.
        rician_k_db: power of the line-of-sight part over the scattered part, in dB.
        generator: the source of the scattered part.
    """
    parts = generator.standard_normal((2, *los.shape)) / np.sqrt(2.0)
    scattered = parts[0] + 1j * parts[1]
    k = 10.0 ** (rician_k_db / 10.0)
    rician = np.sqrt(k / (k + 1.0)) + np.sqrt(1.0 / (k + 1.0)) * scattered
    return np.asarray(np.where(los, rician, scattered))


def coherent_response(
    incoming: float, outgoing: Floats, elements: int, subsurfaces: int
) -> Complexes:
    """c_n(q) = (M / N) |g| |h|, shape (P, N): the elements of each sub-surface add in phase.

    Args:
        incoming: amplitude |g| from the AP to an element.
        outgoing: amplitude |h| from an element to each point, shape (P,).
        elements: M.
        subsurfaces: N, a divisor of M.
    """
    each = (elements // subsurfaces) * incoming * outgoing
    return np.repeat(each[:, None], subsurfaces, axis=1).astype(np.complex128)


def rayleigh_response(
    incoming: float,
    outgoing: Floats,
    elements: int,
    subsurfaces: int,
    generator: np.random.Generator,
) -> Complexes:
    """c_n: elements that fade independently, h_m and g_m circular Gaussian.

    Given all g_m, the sum of h_m g_m over a sub-surface is Gaussian with variance
    |h|^2 sum |g_m|^2, and independent of every other sub-surface and point. So g is drawn element
    by element, and then c_n(q) at once: the same law, without h_m at every point.

    Args:
        incoming: root mean square |g| from the AP to an element.
        outgoing: root mean square |h| from an element to each point, shape (P,).
        elements: M.
        subsurfaces: N, a divisor of M.
        generator: the source of g and h.

    Returns:
        c_n(q), of mean power (M / N) |g|^2 |h|^2, shape (P, N).
    """
    g = incoming * _circular_gaussian((subsurfaces, elements // subsurfaces), generator)
    deviation = np.sqrt((g.real**2 + g.imag**2).sum(axis=-1))
    h = outgoing[:, None] * _circular_gaussian((len(outgoing), subsurfaces), generator)
    return np.asarray(h * deviation)


def _circular_gaussian(shape: tuple[int, ...], generator: np.random.Generator) -> Complexes:
    parts = generator.standard_normal((2, *shape)) / np.sqrt(2.0)
    return np.asarray(parts[0] + 1j * parts[1])


def element_offsets_m(side: int, spacing_m: float, axis: str) -> Floats:
    """Where the elements of a vertical panel are, seen from its centre in m, shape (M_R^2, 3).

    Row by row from the bottom up: M_R = ``side`` along each edge, ``spacing_m`` apart, and
    ``axis``, x or y, being the horizontal one.
    """
    along = (np.arange(side) - (side - 1) / 2.0) * spacing_m
    offsets = np.zeros((side, side, 3))
    offsets[..., "xy".index(axis)] = along
    offsets[..., 2] = along[:, None]
    return offsets.reshape(-1, 3)


Excess = Callable[[Floats, Floats], Floats]


def far_excess_m(to: Floats, offsets_m: Floats) -> Floats:
    """How much longer a point's path is to each element than to the centre, in m: plane waves.

    Points, (P, 3), and elements, (M, 3), are offsets from the panel's centre in m; shape (P, M).
    """
    distance = np.linalg.norm(to, axis=-1, keepdims=True)
    return np.asarray(-(to / np.maximum(distance, _TINY_M)) @ offsets_m.T)


def near_excess_m(to: Floats, offsets_m: Floats) -> Floats:
    """As ``far_excess_m``, with the exact distance of each element.

    |to - offset| - |to|, as a quotient in which nothing cancels far away.
    """
    centre = np.linalg.norm(to, axis=-1, keepdims=True)
    change = (offsets_m**2).sum(axis=-1) - 2.0 * (to @ offsets_m.T)
    element = np.sqrt(np.maximum(centre**2 + change, 0.0))
    return np.asarray(change / np.maximum(element + centre, _TINY_M))


def array_factor(
    ap_m: Floats,
    points_m: Floats,
    offsets_m: Floats,
    subsurfaces: int,
    wavelength_m: float,
    excess: Excess,
) -> Complexes:
    """The sum of e^{-jk (path over the element - path over the centre)} over each sub-surface.

    Lengths are in m; c_n(q) is |g| |h| times this factor.

    Args:
        ap_m: from the panel's centre to the AP, shape (3,).
        points_m: from the centre to each point, shape (P, 3).
        offsets_m: from the centre to each element, shape (M, 3); sub-surface n has the n-th
            M / N of them, as the paper's Kronecker product deals them out.
        subsurfaces: N, a divisor of M.
        wavelength_m: the carrier's wavelength.
        excess: ``far_excess_m`` or ``near_excess_m``.

    Returns:
        Factors, M / N at most in size, shape (P, N).
    """
    elements = len(offsets_m)
    feed = excess(ap_m[None], offsets_m)
    factor = np.empty((len(points_m), subsurfaces), dtype=np.complex128)
    at_once = max(1, MAX_AT_ONCE // max(1, elements))
    for first in range(0, len(points_m), at_once):
        some = points_m[first : first + at_once]
        wave = path_phase(feed + excess(some, offsets_m), wavelength_m)
        each = wave.reshape(len(some), subsurfaces, elements // subsurfaces)
        factor[first : first + at_once] = each.sum(axis=-1)
    return factor


def phases(bits: int) -> Floats:
    """The phase shifts that an element can take, in rad, shape (2^b,), Section II-A."""
    count = 2**bits
    return np.asarray((np.arange(count) + 0.5) * 2.0 * np.pi / count)


def phase_settings(bits: int, subsurfaces: int) -> Complexes:
    """e^{j theta} of every action of the AP, shape (N_R^N, N), with N_R = 2^b.

    Action ``a``'s base-N_R digits are the N phase indices, the first sub-surface's last.
    """
    count = 2**bits
    action = np.arange(count**subsurfaces)
    digits = (action[:, None] // count ** np.arange(subsurfaces)) % count
    return np.asarray(np.exp(1j * phases(bits))[digits])
