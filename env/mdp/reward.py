"""Rewards and energy: pure functions, Eqs. (4), (5a), (8) and (11), Baseline 3 of the paper."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from env import plugins
from env.arrays import Bools, Floats, Ints
from env.config import EnvConfig, MotionConfig, QoeConfig, RewardConfig


def quality_of_experience(rate: Floats, qoe: QoeConfig) -> Floats:
    """Quality of experience, Baseline 3: eta_k = C_1 lg(R_k) + C_2, of R_k in bit/s/Hz, any shape.

    A rate below ``qoe.floor`` counts as the floor.
    """
    # The floor makes a new array: the logarithm's last bit is the same whatever the layout was.
    return np.asarray(qoe.scale * np.log10(np.maximum(rate, qoe.floor)) + qoe.offset)


def metric(rate: Floats, config: EnvConfig) -> Floats:
    """What rewards are made of: R_k itself, or eta_k with ``env.metric=qoe``; same shape."""
    return quality_of_experience(rate, config.qoe) if config.metric == "qoe" else rate


def local_reward(
    rate: Floats, before_m: Floats, after_m: Floats, arrived: Bools, weights: RewardConfig
) -> Floats:
    """A robot's reward: phi R_k + psi (d^{t-1} - kappa d^t) + R_time + R_goal, Eq. (11).

    The paper has kappa = 1. With the robots' discount as kappa the guidance is a potential's, which
    changes no best policy (Ng, Harada and Russell, ICML 1999).

    Args:
        rate: R_k in bit/s/Hz in the slot, or eta_k, any shape; with ``reward.credit`` other than
            ``rate`` what the robot is credited with.
        before_m: distance to the destination before the move, in m.
        after_m: distance after it, in m.
        arrived: whether this move reached the destination.
        weights: phi, psi, kappa, R_time and R_goal.

    Returns:
        The reward, of the broadcast shape.
    """
    if weights.guidance_discount != 1.0:
        after_m = weights.guidance_discount * after_m
    guidance = weights.guidance * (before_m - after_m)
    return weights.rate * rate + guidance + weights.time + np.where(arrived, weights.goal, 0.0)


def rate_weights(travel_slots: Ints, horizon_slots: float) -> Floats:
    """w_k = (horizon / T_k)^2, a robot's 1 / (T_k E_k) of (5a) over that at the horizon.

    T_k, the slots that a robot will have driven in all, is at least 1, of any shape.
    """
    return np.asarray(np.square(horizon_slots / travel_slots))


class RewardFunction:
    """The rewards of an environment, the same on the world's side and on the robots'.

    Args:
        config: the environment; ``reward``, ``metric``, ``access`` and ``qoe`` are read.

    Attributes:
        weighs_credit: whether a robot is credited with more than its own rate.
        weighs_rates: whether the access point's reward weighs rates.
        weighs_absence: whether the credit needs the rates without each robot's signal.

    Raises:
        ValueError: ``env.reward.model`` names none.
    """

    def __init__(self, config: EnvConfig) -> None:
        self._config = config
        self._local = plugins.own_reward(config) or local_reward
        credit = config.reward.credit
        self.weighs_credit = credit != "rate"
        self.weighs_rates = config.reward.weights == "objective"
        # Under OMA no signal disturbs another.
        self.weighs_absence = credit == "difference" and config.access == "noma"

    def weights(self, travel_slots: Ints) -> Floats:
        """w_k of T_k, same shape; see ``rate_weights``."""
        return rate_weights(travel_slots, self._config.reward.horizon_slots)

    def credit(
        self, rate: Floats, drove: Bools, weights: Floats, without: Floats | None = None
    ) -> Floats:
        """What robots are credited with in the place of R_k, with ``weighs_credit``.

        Args:
            rate: R_k in bit/s/Hz, shape (..., K).
            drove: which robots were driving in the slot, shape (..., K).
            weights: w_k before the move, shape (..., K).
            without: with ``weighs_absence``, R_j in the same slot without the signal of robot k,
                shape (..., K, K) with k before j.

        Returns:
            With ``team`` sum_j w_j R_j / w_k over the robots that drove, with ``difference`` that
            less what it is without robot k's signal; 0 where a robot was not driving, shape
            (..., K). In bit/s/Hz of robot k's own rate: w_k stays on a shortest way, so dividing
            by it changes no best policy, and what light and heavy robots are paid is alike in size.
        """
        counted = np.where(drove, metric(rate, self._config), 0.0)
        if self._config.reward.credit == "team":
            team = (weights * counted).sum(axis=-1, keepdims=True)
            return np.where(drove, team / weights, 0.0)
        if without is None:
            return counted
        # What the others lose; robot k's own rate is all its own.
        lost = metric(without, self._config) - counted[..., None, :]
        others = drove[..., None, :] & ~np.eye(drove.shape[-1], dtype=bool)
        harm = np.where(others, weights[..., None, :] * lost, 0.0).sum(axis=-1)
        return np.where(drove, counted - harm / weights, 0.0)

    def of_robots(
        self, credit: Floats, before_m: Floats, after_m: Floats, arrived: Bools
    ) -> Floats:
        """r_L: ``local_reward``, or the user's own; arguments as there.

        ``credit`` is R_k with ``reward.credit=rate``, what ``credit`` gave otherwise.
        """
        counted = credit if self.weighs_credit else metric(credit, self._config)
        return self._local(counted, before_m, after_m, arrived, self._config.reward)

    def of_access_point(self, rate: Floats, drove: Bools, weights: Floats | None = None) -> Floats:
        """r_G of the robots that drove, ``global_reward``; arguments of shape (..., K).

        With ``weighs_rates`` the n rates count for n w_k / sum_j w_j each.
        """
        counted = only(drove, metric(rate, self._config))
        if weights is not None and self.weighs_rates:
            counted = counted * (shares(weights, drove) * drove.sum(axis=-1, keepdims=True))
        return global_reward(counted.sum(axis=-1), self._config.reward)


def only(who: Bools, values: Floats) -> Floats:
    """The values of some, and 0 for all others; same shape, the array itself where all count."""
    return values if np.count_nonzero(who) == who.size else np.where(who, values, 0.0)


def shares(weights: Floats, driving: Bools) -> Floats:
    """Each robot's part of the weight of all that drive, 0 where it does not; shape (..., K)."""
    counted = np.where(driving, weights, 0.0)
    total = counted.sum(axis=-1, keepdims=True)
    return np.asarray(counted / np.where(total > 0.0, total, 1.0))


def global_reward(sum_rate: Floats, weights: RewardConfig) -> Floats:
    """The access point's reward: tau_1 sum_k R_k (plus an offset, 0 by default), Eq. (8).

    The sum is in bit/s/Hz, or of eta_k, weighted or not, of any shape.
    """
    return weights.sum_rate * sum_rate + weights.global_offset


def motion_energy_j(travel_s: NDArray[np.floating], motion: MotionConfig) -> Floats:
    """Energy of driving for T_k seconds: E_k = E_1 T_k v + E_2 T_k in J, Eq. (4), any shape."""
    return np.asarray((motion.energy_per_m_j * motion.speed_mps + motion.idle_power_w) * travel_s)


def energy_efficiency(rate_sum: Floats, slots: Ints, slot_s: float, motion: MotionConfig) -> Floats:
    """Energy efficiency of an episode, the objective (5a): sum_k (1/T_k) sum_t R_k^t / E_k.

    Args:
        rate_sum: sum over t of R_k^t in bit/s/Hz, shape (..., K).
        slots: slots that each robot drove, at least 1, shape (..., K).
        slot_s: length of a slot in s.
        motion: E_1, E_2 and v.

    Returns:
        In bit/s/Hz/J, shape (...).
    """
    return np.asarray((rate_sum / slots / motion_energy_j(slots * slot_s, motion)).sum(axis=-1))


def bits_per_joule(
    rate_sum: Floats, slots: Ints, slot_s: float, bandwidth_hz: float, motion: MotionConfig
) -> Floats:
    """All bits over all energy of an episode in bit/J: sum_k sum_t R_k^t B T_slot / sum_k E_k.

    Arguments are those of ``energy_efficiency``, and B in Hz.
    """
    bits = rate_sum.sum(axis=-1) * (bandwidth_hz * slot_s)
    return np.asarray(bits / motion_energy_j(slots * slot_s, motion).sum(axis=-1))
