"""The dueling network's last step, and the way back through it.

Wang et al., "Dueling network architectures for deep reinforcement learning", ICML 2016. Both
streams are one linear layer on the shared hidden layers, so they lie in one matrix: the advantages
of the actions first, the value of the state last.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_FloatArray = NDArray[np.float32]


def action_values(streams: _FloatArray, axis: int) -> _FloatArray:
    """Q(s, a) = V(s) + A(s, a) - mean of A(s, .) over the actions, Eq. (9).

    Args:
        streams: advantages, and the value last, along `axis`.
        axis: of the actions.

    Returns:
        Values of the actions, an array of its own that is one shorter along `axis`.
    """
    advantages, value = np.split(streams, [-1], axis=axis)
    mean = np.add.reduce(advantages, axis=axis, keepdims=True)
    mean *= np.float32(1 / advantages.shape[axis])
    values: _FloatArray = advantages + (value - mean)
    return values


def streams_slope(slope: _FloatArray, out: _FloatArray) -> None:
    """The loss's slope at both streams, from its slope at the action values.

    Args:
        slope: shape (n, actions, B).
        out: to fill, shape (n, actions + 1, B).
    """
    np.add.reduce(slope, axis=1, out=out[:, -1])
    share = out[:, -1] * np.float32(1 / slope.shape[1])
    np.subtract(slope, share[:, None], out=out[:, :-1])
