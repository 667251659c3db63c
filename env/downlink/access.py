"""Downlink NOMA and OMA: decoding order, decodability, rates. Pure functions, leading batch.

NOMA is in *rank order*: along the last axis, strongest channel first. Ranks past the robots that
are served have power 0, add nothing, and get rate 0. OMA knows no ranks: any order will do.
"""

from __future__ import annotations

import numpy as np

from env.arrays import Bools, Floats, Ints


def decoding_order(gain: Floats, served: Bools) -> Ints:
    """The robots from the strongest channel to the weakest, |h_1| >= ... >= |h_K|, shape (..., K).

    Ties go by the robots' index, and robots that are not ``served`` come last; ``gain`` is |h_k|^2.
    """
    return np.where(served, -gain, np.inf).argsort(axis=-1, kind="stable")


def ranks(gain: Floats, served: Bools) -> Ints:
    """Each robot's rank in ``decoding_order``, 0 the strongest, shape (..., K)."""
    return np.argsort(decoding_order(gain, served), axis=-1)


def sic_margins(gain: Floats, power_w: Floats) -> Floats:
    """Delta_k of Eq. (2): how far signal k stands out at robot k-1.

    Args:
        gain: |h_k|^2 by rank, shape (..., K).
        power_w: p_k in W by rank, shape (..., K).

    Returns:
        Delta_k in W for k = 2..K, shape (..., K-1).
    """
    stronger = np.cumsum(power_w, axis=-1)[..., :-1]
    return np.asarray((power_w[..., 1:] - stronger) * gain[..., :-1])


def sic_failures(gain: Floats, power_w: Floats, served: Bools, margin_w: float) -> Bools:
    """Which signals break Eq. (2), so that stronger robots cannot cancel them.

    Args:
        gain: |h_k|^2 by rank, shape (..., K).
        power_w: p_k in W by rank, shape (..., K).
        served: whether a rank is served, shape (..., K).
        margin_w: rho_min in W.

    Returns:
        True where Delta_k < rho_min, shape (..., K); never at the strongest rank.
    """
    failed = np.zeros(np.broadcast_shapes(gain.shape, power_w.shape), dtype=bool)
    failed[..., 1:] = (sic_margins(gain, power_w) < margin_w) & served[..., 1:]
    return failed


def downlink_rates(
    gain: Floats, power_w: Floats, noise_w: float, residual: Bools | None = None
) -> Floats:
    """NOMA rates after successive interference cancellation, Eq. (3).

    Args:
        gain: |h_k|^2 by rank, shape (..., K).
        power_w: p_k in W by rank, shape (..., K).
        noise_w: sigma^2 in W.
        residual: signals that stronger robots cannot cancel, shape (..., K): their power then
            stays as interference at every stronger rank. None: all are cancelled.

    Returns:
        R_k in bit/s/Hz by rank, shape (..., K).
    """
    interference = np.add.accumulate(power_w, axis=-1) - power_w
    if residual is not None:
        left = np.where(residual, power_w, 0.0)
        interference = interference + left[..., ::-1].cumsum(axis=-1)[..., ::-1] - left
    return np.log2(1.0 + gain * power_w / (gain * interference + noise_w))


def oma_rates(gain: Floats, power_w: Floats, noise_w: float, parts: Ints) -> Floats:
    """OMA rates, Baseline 2: R_k = (1/n) log2(1 + |h_k|^2 p_k / (sigma^2 / n)).

    Args:
        gain: |h_k|^2, shape (..., K).
        power_w: p_k in W, 0 where not served, shape (..., K).
        noise_w: sigma^2 of the whole band in W.
        parts: n, into how many the band is divided, at least 1, broadcast against ``gain``; the
            paper's is K.

    Returns:
        R_k in bit/s/Hz of the whole band, shape (..., K).
    """
    return np.asarray(np.log2(1.0 + gain * power_w / (noise_w / parts)) / parts)
