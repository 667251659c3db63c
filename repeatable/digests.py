"""Digests of models, by which runs are compared."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from flwr.app import ArrayRecord
from numpy.typing import NDArray

from storage.checkpoint_files import arrays_digest


def digest(arrays: ArrayRecord | Mapping[str, NDArray[np.generic]]) -> str:
    """Whether two models are the same to the bit: then, and only then, so are their digests.

    Args:
        arrays: a model; names, types, shapes and values count, and not their order.

    Returns:
        SHA-256 as 64 hexadecimal digits.
    """
    if isinstance(arrays, ArrayRecord):
        arrays = {name: array.numpy() for name, array in arrays.items()}
    return arrays_digest(arrays)
