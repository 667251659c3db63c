"""One slot of downlink: from channels and power picks to powers and rates, for every switch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from env import access
from env.config import EnvConfig
from env.power import Projection, fractions, scaled_to_budget


@dataclass(frozen=True)
class Allocation:
    """What the AP sends in one slot; arrays are in robot order, shape (..., K).

    Attributes:
        rate: R_k in bit/s/Hz, 0 where not served.
        power_w: p_k in W, 0 where not served.
        order: the robot at each rank, strongest channel first.
        sic_failed: whether Eq. (2) fails for a robot's signal with the powers sent.
        projected: whether the AP changed any pick, shape (...).
        margin_dropped: whether no feasible powers kept rho_min, shape (...).
    """

    rate: NDArray[np.float64]
    power_w: NDArray[np.float64]
    order: NDArray[np.int64]
    sic_failed: NDArray[np.bool_]
    projected: NDArray[np.bool_]
    margin_dropped: NDArray[np.bool_]


class Downlink:
    """The AP's rule for powers and rates: access scheme and resolution of picks.

    Args:
        config: the environment; ``power``, ``noise`` and ``access`` are read.
    """

    def __init__(self, config: EnvConfig) -> None:
        power, noise = config.power, config.noise
        self.levels = power.levels
        self.max_power_w = 10.0 ** ((power.max_dbm - 30.0) / 10.0)
        self.noise_w = 10.0 ** ((noise.density_dbm_per_hz - 30.0) / 10.0) * noise.bandwidth_hz
        self.margin_w = power.sic_margin * self.noise_w
        self._resolve = power.resolve
        projects = power.resolve == "project"
        self._projection = Projection(config.robots, power.levels) if projects else None

    def allocate(
        self, gain: NDArray[np.float64], picks: NDArray[np.int64], served: NDArray[np.bool_]
    ) -> Allocation:
        """Orders the robots, resolves their picks and computes the rates.

        Args:
            gain: |h_k|^2, shape (B, K).
            picks: power levels 1..N_P, shape (B, K).
            served: whether a robot is served, shape (B, K).

        Returns:
            The allocation, arrays of shape (B, K).
        """
        order = access.decoding_order(gain, served)
        ranked_gain = np.take_along_axis(gain, order, axis=-1)
        ranked_served = np.take_along_axis(served, order, axis=-1)
        ranked_picks = np.take_along_axis(np.where(served, picks, 0), order, axis=-1)
        fraction, projected, dropped = self._powers(ranked_gain, ranked_picks, ranked_served)
        power_w = fraction * self.max_power_w
        failed = access.sic_failures(ranked_gain, power_w, ranked_served, self.margin_w)
        residual = failed if self._resolve == "residual" else None
        rate = access.downlink_rates(ranked_gain, power_w, self.noise_w, residual)
        if self._resolve == "zero":
            rate = np.where(failed, 0.0, rate)
        back = np.argsort(order, axis=-1)
        return Allocation(
            rate=np.take_along_axis(rate, back, axis=-1),
            power_w=np.take_along_axis(power_w, back, axis=-1),
            order=order,
            sic_failed=np.take_along_axis(failed, back, axis=-1),
            projected=projected,
            margin_dropped=dropped,
        )

    def _powers(
        self, gain: NDArray[np.float64], picks: NDArray[np.int64], served: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
        """Fractions of P_max by rank, and where picks were changed or the margin dropped."""
        if self._projection is None:
            nowhere = np.zeros(len(picks), dtype=bool)
            return scaled_to_budget(fractions(picks)), nowhere, nowhere
        least_gap = self.margin_w / self.max_power_w / np.maximum(gain[:, :-1], 1e-300)
        levels, dropped = self._projection(picks, served.sum(axis=-1), least_gap)
        return fractions(levels), (levels != picks).any(axis=-1), dropped
