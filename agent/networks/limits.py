"""Which weights are absurd: not what any learner comes to, but what a fault or an attack makes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

WEIGHT_LIMIT = 1e4
"""The largest magnitude of a weight that is taken from anybody.

The weights of trained networks were below 1 (docs/security.md has what was measured). Adam moves a
weight by at most (1 - beta_1) / sqrt(1 - beta_2) = 3.2 learning rates an update (Kingma and Ba,
2015, section 2.1), so at the paper's 1e-4 no run of less than 30 million updates can pass this.
What does are overflows, bits that flipped high in an exponent, bytes that are no weights at all,
and learning rates with which nothing is learned.
"""


def check_weights(weights: NDArray[np.float32], said: str) -> None:
    """Refuses absurd weights, an array that is not empty.

    Raises:
        ValueError: a weight is not finite or beyond ``WEIGHT_LIMIT``; the message begins as `said`
            and has the value.
    """
    if not (largest := magnitude(weights)) <= WEIGHT_LIMIT:
        raise ValueError(
            f"{said} ({largest:.3g}): finite ones of at most {WEIGHT_LIMIT:g} are taken"
        )


def magnitude(weights: NDArray[np.float32]) -> float:
    """The largest magnitude in an array, nan if there is one in it; makes no copy of the array."""
    return float(np.maximum(weights.max(), -weights.min()))
