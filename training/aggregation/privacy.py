"""Central differential privacy: Flower's wrappers around a strategy, with noise of the run's own.

A wrapper clips each robot's step from the common model to the norm C and adds Gaussian noise of the
deviation z C / K to the mean of K. What that protects, and what not: docs/privacy.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from flwr.app import ArrayRecord
from flwr.serverapp.strategy import (
    DifferentialPrivacyServerSideAdaptiveClipping,
    DifferentialPrivacyServerSideFixedClipping,
    Strategy,
)

from conf import PrivacyConfig

FLOWERS_COUNT_NOISE = 1 / 20
"""Deviation of the noise on the count of clipped steps, for each robot, by default."""


class AdaptiveClipping(DifferentialPrivacyServerSideAdaptiveClipping):
    """Flower's, with a clip that moves towards the quantile.

    Flower 1.41 counts steps that were clipped where Andrew et al. (Eq. (1)) count those that were
    not: its clip falls the faster the more is clipped, and ends at zero or infinity. And it moves
    the clip before it adds the noise of a window, whose steps the clip of before has bounded.
    """

    _bounded_by = 0.0

    def _geometric_update(self, clipped_fraction: float) -> None:
        self._bounded_by = self.clipping_norm
        super()._geometric_update(1.0 - clipped_fraction)

    def _add_noise_to_aggregated_arrays(self, aggregated: ArrayRecord) -> ArrayRecord:
        moved, self.clipping_norm = self.clipping_norm, self._bounded_by
        noisy = super()._add_noise_to_aggregated_arrays(aggregated)
        self.clipping_norm = moved
        del self._bounded_by  # of this window alone
        return noisy


def protected(strategy: Strategy, dp: PrivacyConfig, robots: int) -> Strategy:
    """A plain mean of K robots with the central privacy that ``strategy.dp`` asks for, if any."""
    clip = np.float64(dp.clip)  # of NumPy: over the norm of a robot that did not move it is inf
    if dp.name == "central":
        return DifferentialPrivacyServerSideFixedClipping(strategy, dp.noise, clip, robots)
    if dp.name == "adaptive":
        count_noise = max(FLOWERS_COUNT_NOISE * robots, dp.noise) if dp.noise else None
        return AdaptiveClipping(
            strategy, dp.noise, robots, clip, dp.quantile, dp.clip_rate, count_noise
        )
    return strategy


def averaging(strategy: Strategy, count: int) -> Strategy:
    """What averages within a wrapper, which is told how many steps its noise is divided by."""
    if isinstance(
        strategy,
        DifferentialPrivacyServerSideFixedClipping | DifferentialPrivacyServerSideAdaptiveClipping,
    ):
        strategy.num_sampled_clients = count
        return strategy.strategy
    return strategy


@contextmanager
def drawing_from(generator: np.random.Generator) -> Iterator[None]:
    """Lets NumPy's global functions, which Flower calls, draw from a generator for a while."""
    shared: Any = np.random  # whose stubs leave out its bit generator
    before, state = shared.get_bit_generator(), shared.get_state(legacy=False)
    shared.set_bit_generator(generator.bit_generator)
    try:
        with np.errstate(divide="ignore"):  # the clip over a norm of zero
            yield
    finally:
        shared.set_bit_generator(before)
        shared.set_state(state)
