"""Checks of what is to be combined, whatever combines it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.networks.limits import WEIGHT_LIMIT, magnitude


def check_uploads(
    window: int,
    uploads: NDArray[np.float32],
    who: str = "robot",
    robots: NDArray[np.intp] | None = None,
) -> None:
    """Refuses weights that are not finite or beyond ``WEIGHT_LIMIT``.

    Args:
        window: its number.
        uploads: a row each, shape (K, 2, P).
        who: what uploads, for the message.
        robots: whose each row is, ascending; row k is robot k's if None.

    Raises:
        ValueError: there are such; the message names whose.
    """
    largest = [magnitude(upload) for upload in uploads]
    if absurd := [k for k, value in enumerate(largest) if not value <= WEIGHT_LIMIT]:
        numbers = np.arange(len(uploads)) if robots is None else robots
        named = ", ".join(f"{who} {numbers[each]} ({largest[each]:.3g})" for each in absurd)
        raise ValueError(
            f"window {window}: absurd weights from {named}, of {who}s {numbers[0]} to"
            f" {numbers[-1]}: finite ones of at most {WEIGHT_LIMIT:g} are taken"
        )
