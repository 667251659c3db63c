"""Rewards and energy: pure functions, Eqs. (4), (5a), (8) and (11), Baseline 3 of the paper."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from env import plugins
from env.config import EnvConfig, MotionConfig, QoeConfig, RewardConfig


def quality_of_experience(rate: NDArray[np.float64], qoe: QoeConfig) -> NDArray[np.float64]:
    """Quality of experience, Baseline 3: eta_k = C_1 lg(R_k) + C_2.

    Args:
        rate: R_k in bit/s/Hz, any shape.
        qoe: C_1, C_2 and the floor below which a rate counts as the floor.

    Returns:
        eta_k, same shape.
    """
    # The floor makes a new array: the logarithm's last bit is the same whatever the layout was.
    return np.asarray(qoe.scale * np.log10(np.maximum(rate, qoe.floor)) + qoe.offset)


def metric(rate: NDArray[np.float64], config: EnvConfig) -> NDArray[np.float64]:
    """What rewards are made of: R_k itself, or eta_k with ``env.metric=qoe``; same shape."""
    return quality_of_experience(rate, config.qoe) if config.metric == "qoe" else rate


def local_reward(
    rate: NDArray[np.float64],
    before_m: NDArray[np.float64],
    after_m: NDArray[np.float64],
    arrived: NDArray[np.bool_],
    weights: RewardConfig,
) -> NDArray[np.float64]:
    """A robot's reward: phi R_k + psi (d^{t-1} - d^t) + R_time + R_goal, Eq. (11).

    Args:
        rate: R_k in bit/s/Hz in the slot, or eta_k, any shape.
        before_m: distance to the destination before the move, in m.
        after_m: distance after it, in m.
        arrived: whether this move reached the destination.
        weights: phi, psi, R_time and R_goal.

    Returns:
        The reward, of the broadcast shape.
    """
    guidance = weights.guidance * (before_m - after_m)
    return weights.rate * rate + guidance + weights.time + np.where(arrived, weights.goal, 0.0)


class RewardFunction:
    """The rewards of an environment, the same on the world's side and on the robots'.

    Args:
        config: the environment; ``reward``, ``metric`` and ``qoe`` are read.

    Raises:
        ValueError: ``env.reward.model`` names none.
    """

    def __init__(self, config: EnvConfig) -> None:
        self._config = config
        self._local = plugins.own_reward(config) or local_reward

    def of_robots(
        self,
        rate: NDArray[np.float64],
        before_m: NDArray[np.float64],
        after_m: NDArray[np.float64],
        arrived: NDArray[np.bool_],
    ) -> NDArray[np.float64]:
        """r_L: ``local_reward``, or the user's own; arguments as there, ``rate`` as R_k."""
        counted = metric(rate, self._config)
        return self._local(counted, before_m, after_m, arrived, self._config.reward)

    def of_access_point(
        self, rate: NDArray[np.float64], drove: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """r_G of the robots that drove, ``global_reward``; both of shape (..., K)."""
        counted = only(drove, metric(rate, self._config))
        return global_reward(counted.sum(axis=-1), self._config.reward)


def only(who: NDArray[np.bool_], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The values of some, and 0 for all others; same shape, the array itself where all count."""
    return values if np.count_nonzero(who) == who.size else np.where(who, values, 0.0)


def global_reward(sum_rate: NDArray[np.float64], weights: RewardConfig) -> NDArray[np.float64]:
    """The access point's reward: tau_1 sum_k R_k (plus an offset, 0 by default), Eq. (8).

    Args:
        sum_rate: sum_k R_k in bit/s/Hz, or of eta_k, any shape.
        weights: tau_1 and the offset.

    Returns:
        The reward, same shape.
    """
    return weights.sum_rate * sum_rate + weights.global_offset


def motion_energy_j(travel_s: NDArray[np.floating], motion: MotionConfig) -> NDArray[np.float64]:
    """Energy of driving for T_k seconds: E_1 T_k v + E_2 T_k, Eq. (4).

    Args:
        travel_s: T_k in s, any shape.
        motion: E_1, E_2 and v.

    Returns:
        E_k in J, same shape.
    """
    return np.asarray((motion.energy_per_m_j * motion.speed_mps + motion.idle_power_w) * travel_s)


def energy_efficiency(
    rate_sum: NDArray[np.float64], slots: NDArray[np.int64], slot_s: float, motion: MotionConfig
) -> NDArray[np.float64]:
    """Energy efficiency of an episode, the objective (5a): sum_k (1/T_k) sum_t R_k^t / E_k.

    Args:
        rate_sum: sum over t of R_k^t in bit/s/Hz, shape (..., K).
        slots: slots that each robot drove, at least 1, shape (..., K).
        slot_s: length of a slot in s.
        motion: E_1, E_2 and v.

    Returns:
        Energy efficiency in bit/s/Hz/J, shape (...).
    """
    return np.asarray((rate_sum / slots / motion_energy_j(slots * slot_s, motion)).sum(axis=-1))


def bits_per_joule(
    rate_sum: NDArray[np.float64],
    slots: NDArray[np.int64],
    slot_s: float,
    bandwidth_hz: float,
    motion: MotionConfig,
) -> NDArray[np.float64]:
    """All bits over all energy of an episode: sum_k sum_t R_k^t B T_slot / sum_k E_k.

    Args:
        rate_sum: sum over t of R_k^t in bit/s/Hz, shape (..., K).
        slots: slots that each robot drove, at least 1, shape (..., K).
        slot_s: T_slot in s.
        bandwidth_hz: B in Hz.
        motion: E_1, E_2 and v.

    Returns:
        Energy efficiency in bit/J, shape (...).
    """
    bits = rate_sum.sum(axis=-1) * (bandwidth_hz * slot_s)
    return np.asarray(bits / motion_energy_j(slots * slot_s, motion).sum(axis=-1))
