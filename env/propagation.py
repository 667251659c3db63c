"""Path loss, fading and the RIS's response: pure functions of distances and generators."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def path_loss_db(
    distance_m: NDArray[np.float64], frequency_ghz: float, los: NDArray[np.bool_] | bool
) -> NDArray[np.float64]:
    """Path loss of the indoor hotspot, 3GPP TR 38.901 Table 7.4.1-1.

    Args:
        distance_m: 3-D distance in m, any shape, above 0.
        frequency_ghz: carrier frequency in GHz.
        los: whether the link is in line of sight, broadcast with ``distance_m``.

    Returns:
        Loss in dB, of the broadcast shape.
    """
    log_d, log_f = np.log10(distance_m), np.log10(frequency_ghz)
    clear = 32.4 + 17.3 * log_d + 20.0 * log_f
    blocked = np.maximum(clear, 17.3 + 38.3 * log_d + 24.9 * log_f)
    return np.asarray(np.where(los, clear, blocked))


def amplitude(loss_db: NDArray[np.float64]) -> NDArray[np.float64]:
    """The amplitude gain of a link with a given loss in dB, same shape."""
    return np.asarray(10.0 ** (-loss_db / 20.0))


def small_scale_fading(
    los: NDArray[np.bool_], rician_k_db: float, generator: np.random.Generator
) -> NDArray[np.complex128]:
    """Fading of unit mean power: Rician in line of sight, Rayleigh out of it.

    The line-of-sight part has phase zero (``docs/assumptions.md``, C-PHASE).

    Args:
        los: whether each link is in line of sight, shape (P,).
        rician_k_db: power of the line-of-sight part over the scattered part, in dB.
        generator: the source of the scattered part.

    Returns:
        Complex factors, shape (P,).
    """
    parts = generator.standard_normal((2, *los.shape)) / np.sqrt(2.0)
    scattered = parts[0] + 1j * parts[1]
    k = 10.0 ** (rician_k_db / 10.0)
    rician = np.sqrt(k / (k + 1.0)) + np.sqrt(1.0 / (k + 1.0)) * scattered
    return np.asarray(np.where(los, rician, scattered))


def coherent_response(
    incoming: float, outgoing: NDArray[np.float64], elements: int, subsurfaces: int
) -> NDArray[np.complex128]:
    """c_n: the elements of each sub-surface add in phase.

    Args:
        incoming: amplitude |g| from the AP to an element.
        outgoing: amplitude |h| from an element to each point, shape (P,).
        elements: M.
        subsurfaces: N, a divisor of M.

    Returns:
        c_n(q) = (M / N) |g| |h|, shape (P, N).
    """
    each = (elements // subsurfaces) * incoming * outgoing
    return np.repeat(each[:, None], subsurfaces, axis=1).astype(np.complex128)


def phases(bits: int) -> NDArray[np.float64]:
    """The phase shifts that an element can take, in rad, shape (2^b,), Section II-A."""
    count = 2**bits
    return np.asarray((np.arange(count) + 0.5) * 2.0 * np.pi / count)


def phase_settings(bits: int, subsurfaces: int) -> NDArray[np.complex128]:
    """e^{j theta} of every action of the AP.

    Action ``a``'s base-N_R digits are the N phase indices, the first sub-surface's last.

    Args:
        bits: b, with N_R = 2^b.
        subsurfaces: N.

    Returns:
        Factors, shape (N_R^N, N).
    """
    count = 2**bits
    action = np.arange(count**subsurfaces)
    digits = (action[:, None] // count ** np.arange(subsurfaces)) % count
    return np.asarray(np.exp(1j * phases(bits))[digits])
