"""What a window has shown the server, for the exchange of weights at its end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lockstep import Payload


@dataclass(frozen=True, eq=False)
class WindowFacts:
    """What the server knows of a window beside the uploads.

    Attributes:
        channel_db: 10 lg |h|^2 of each robot at its end, shape (K,).
        actions: how often each robot took each action in it, shape (K, actions).
    """

    channel_db: NDArray[np.float64]
    actions: NDArray[np.int64]


def plain(payload: Payload) -> NDArray[np.float32]:
    """Weights that were sent as they are; a ``TypeError`` if they are packed."""
    if payload.dtype != np.float32:
        raise TypeError("weights are packed where plain ones are due")
    return payload
