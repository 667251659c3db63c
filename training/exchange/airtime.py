"""What the exchange of weights takes of the channel that it shares with the robots' data.

At a window's end the robots that are asked send one after the other (TDMA), and the access point
then broadcasts at the rate of the weakest robot. Rates are those of the direct channels, at P_max
and the noise of the downlink. Nobody is served data meanwhile, and robots drive on. All of this is
an account beside the run: it changes nothing in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conf import Config
from env.downlink.access import downlink_rates
from env.mdp.reward import motion_energy_j
from training.exchange.facts import WindowFacts
from training.exchange.packing import payload_bytes

LEAST_RATE = 0.01
"""In bit/s/Hz: repetition carries weights through any fade at this rate."""

COUNTED = ("ee", "ee_bits_per_joule")
"""The measures that are given with the exchange counted."""


class Airtime:
    """Adds up the slots and joules of the exchanges of a run whose robots learn."""

    def __init__(self, config: Config) -> None:
        env = config.env
        self._motion, self._every = env.motion, config.federation.every
        self._slot_s = env.room.cell_m / env.motion.speed_mps
        self._power_w = 10.0 ** ((env.power.max_dbm - 30.0) / 10.0)
        noise = env.noise
        self._noise_w = 10.0 ** ((noise.density_dbm_per_hz - 30.0) / 10.0) * noise.bandwidth_hz
        bandwidth_hz = config.federation.airtime.bandwidth_hz
        up, down = payload_bytes(config)
        self._up_s, self._down_s = 8 * up / bandwidth_hz, 8 * down / bandwidth_hz
        self._worlds = config.train.worlds
        self._slots = self._driven = 0.0
        self._ticks = 0

    def add(self, facts: WindowFacts, asked: NDArray[np.intp]) -> None:
        """Counts the exchange at a window's end, in which the robots that are asked send, (M,)."""
        rates = self._rates(facts.channel_db)
        took_s = (self._up_s / rates[asked]).sum() + self._down_s / rates.min()
        self._slots += float(took_s) / self._slot_s
        self._driven += float(facts.actions.sum()) / self._worlds
        self._ticks += self._every

    def _rates(self, channel_db: NDArray[np.float64]) -> NDArray[np.float64]:
        """What each robot alone on the channel can send, or hear, in bit/s/Hz, shape (K,)."""
        gain = 10.0 ** (np.asarray(channel_db, np.float64)[:, None] / 10.0)
        alone = downlink_rates(gain, np.array([self._power_w]), self._noise_w)[:, 0]
        return np.maximum(alone, LEAST_RATE)

    def summary(self, measures: Mapping[str, float]) -> dict[str, float]:
        """What ``summary.json`` says of it, from measures that do not count the exchange.

        Returns:
            ``slots`` that exchanges took, and their ``share`` of all; ``joules`` sent with, and
            ``driving_joules`` beside; each measure of ``COUNTED``, and with ``_counted`` what is
            left of it if exchanges go on: its bits less that share, its joules more by theirs.
        """
        joules = self._slots * self._slot_s * self._power_w
        driving = float(motion_energy_j(np.array(self._driven * self._slot_s), self._motion))
        share = self._slots / max(self._ticks, 1)
        left = left_over(share, joules, driving)
        return {
            "slots": self._slots,
            "share": share,
            "joules": joules,
            "driving_joules": driving,
            **{name: measures[name] for name in COUNTED},
            **{f"{name}_counted": left * measures[name] for name in COUNTED},
        }

    def state(self) -> dict[str, NDArray[Any]]:
        """What was counted so far."""
        return {"counted": np.array([self._slots, self._driven, self._ticks])}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave; nothing is a fresh account."""
        slots, driven, ticks = state.get("counted", np.zeros(3)).tolist()
        self._slots, self._driven, self._ticks = slots, driven, int(ticks)


def left_over(share: float, joules: float, driving_joules: float) -> float:
    """What is left of an energy efficiency once exchanges are counted, as a factor.

    Exchanges take a share of all slots, of which from 1 on nothing is left, and joules beside
    those that robots drive with meanwhile.
    """
    return max(0.0, 1.0 - share) / (1.0 + joules / driving_joules if driving_joules else 1.0)
