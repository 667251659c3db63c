"""One slot of downlink: from channels and power picks to powers and rates, for every switch."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from env.arrays import Bools, Floats, Ints
from env.config import EnvConfig
from env.downlink import access
from env.downlink.power import Projection, fractions, scaled_to_budget

TINY = 1e-300
_Value = TypeVar("_Value", bound=np.generic)


class Allocation(NamedTuple):
    """What the AP sends in one slot; arrays are in robot order, shape (..., K).

    Attributes:
        rate: R_k in bit/s/Hz, 0 where not served.
        power_w: p_k in W, 0 where not served.
        order: the robot at each rank, strongest channel first.
        sic_failed: whether Eq. (2) fails for a robot's signal with the powers sent; as the two
            below, never under OMA, where nobody decodes the signals of others.
        projected: whether the AP changed any pick, shape (...).
        margin_dropped: whether no feasible powers kept rho_min, shape (...).
    """

    rate: Floats
    power_w: Floats
    order: Ints
    sic_failed: Bools
    projected: Bools
    margin_dropped: Bools


class Downlink:
    """The AP's rule for powers and rates: access scheme and resolution of picks.

    Args:
        config: the environment; ``power``, ``noise``, ``access`` and ``oma`` are read.
    """

    def __init__(self, config: EnvConfig) -> None:
        power, noise = config.power, config.noise
        self.levels = power.levels
        self.max_power_w = 10.0 ** ((power.max_dbm - 30.0) / 10.0)
        self.noise_w = 10.0 ** ((noise.density_dbm_per_hz - 30.0) / 10.0) * noise.bandwidth_hz
        self.margin_w = power.sic_margin * self.noise_w
        self._orthogonal = config.access == "oma"
        self._reallocates = config.oma.share == "reallocate"
        self._resolve = power.resolve
        projects = power.resolve == "project" and not self._orthogonal
        self._projection = Projection(config.robots, power.levels) if projects else None
        self._least_gain = self.margin_w / self.max_power_w
        self._power_w = fractions(np.arange(power.levels + 1)) * self.max_power_w

    def allocate(self, gain: Floats, picks: Ints, served: Bools) -> Allocation:
        """Orders the robots, resolves their picks and computes the rates; arrays of shape (B, K).

        Args:
            gain: |h_k|^2.
            picks: power levels 1..N_P; of no effect under OMA.
            served: whether a robot is served.
        """
        if self._orthogonal:
            return self._allocate_parts(gain, served)
        order = access.decoding_order(gain, served)
        place = order
        if len(gain) > 1:
            place = order + np.arange(0, gain.size, gain.shape[-1])[:, None]
        ranked = gain.take(place)
        if np.count_nonzero(served) < served.size:
            picks = picks * served
        sent = self._send(ranked, picks.take(place))
        residual = sent.failed if self._resolve == "residual" else None
        rate = access.downlink_rates(ranked, sent.power_w, self.noise_w, residual)
        if self._resolve == "zero":
            rate = np.where(sent.failed, 0.0, rate)
        return Allocation(
            rate=_unranked(rate, place),
            power_w=_unranked(sent.power_w, place),
            order=order,
            sic_failed=_unranked(sent.failed, place),
            projected=sent.projected,
            margin_dropped=sent.margin_dropped,
        )

    def rates_without(self, gain: Floats, sent: Allocation) -> Floats:
        """NOMA rates of a slot with the same powers but without the signal of one robot.

        Stronger robots than that one have cancelled its signal anyway; weaker ones lose its
        interference. True where all signals are cancelled, so with ``power.resolve=project``.

        Args:
            gain: |h_k|^2, shape (B, K).
            sent: what was sent over these channels.

        Returns:
            R_j without robot k's signal in bit/s/Hz, shape (B, K, K) with k before j; 0 at k
            itself.
        """
        order, robots = sent.order, gain.shape[-1]
        ranked, power_w = (
            np.take_along_axis(each, order, axis=-1)[:, None] for each in (gain, sent.power_w)
        )
        power_w = np.where(np.eye(robots, dtype=bool), 0.0, power_w)
        rate = np.empty_like(power_w)
        row = np.arange(len(gain))[:, None, None]
        rate[row, order[:, :, None], order[:, None, :]] = access.downlink_rates(
            ranked, power_w, self.noise_w
        )
        return rate

    def _allocate_parts(self, gain: Floats, served: Bools) -> Allocation:
        """Baseline 2: equal parts of band and power, p_k = P_max / n, for each robot served."""
        rows, robots = gain.shape
        parts = np.full((rows, 1), robots)
        if self._reallocates:
            parts = np.maximum(served.sum(axis=-1, keepdims=True), 1)
        power_w = np.where(served, self.max_power_w / parts, 0.0)
        never = np.zeros(rows, dtype=bool)
        return Allocation(
            rate=access.oma_rates(gain, power_w, self.noise_w, parts),
            power_w=power_w,
            order=access.decoding_order(gain, served),
            sic_failed=np.zeros_like(served),
            projected=never,
            margin_dropped=never,
        )

    def _send(self, gain: Floats, picks: Ints) -> _Sent:
        """Resolves picks, all in rank order, shape (B, K); picks are 0 where not served."""
        if self._projection is None:
            nowhere = np.zeros(len(picks), dtype=bool)
            power_w = scaled_to_budget(fractions(picks)) * self.max_power_w
            return _Sent(power_w, self._failures(gain, power_w, picks), nowhere, nowhere)
        least_gap = self._least_gain / np.maximum(gain[:, :-1], TINY)
        levels, changed, dropped = self._projection(picks, least_gap)
        power_w = self._power_w.take(levels)
        failed = np.zeros(picks.shape, dtype=bool)
        if np.count_nonzero(dropped):
            failed[dropped] = self._failures(gain, power_w, picks)[dropped]
        return _Sent(power_w, failed, changed, dropped)

    def _failures(self, gain: Floats, power_w: Floats, picks: Ints) -> Bools:
        """Where Eq. (2) fails, by rank, shape (B, K)."""
        return access.sic_failures(gain, power_w, picks > 0, self.margin_w)


class _Sent(NamedTuple):
    """What is sent, in rank order, shape (B, K), and what became of the picks, shape (B,)."""

    power_w: Floats
    failed: Bools
    projected: Bools
    margin_dropped: Bools


def _unranked(values: NDArray[_Value], place: Ints) -> NDArray[_Value]:
    """Values by rank, put back into robot order; ``place`` is each rank's flat index."""
    result = np.empty_like(values)
    result.put(place, values)
    return result
