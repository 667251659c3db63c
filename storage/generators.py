"""A random stream's state as an array, to be stored beside the weights."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_WORD = 1 << 64


def generator_state(generator: np.random.Generator) -> NDArray[np.uint64]:
    """Where a generator on PCG64, NumPy's default, stands.

    Returns:
        State and increment (high and low words), and its spare 32 bits, shape (6,).
    """
    state: dict[str, Any] = dict(generator.bit_generator.state)
    if state["bit_generator"] != "PCG64":
        raise ValueError(f"cannot store a {state['bit_generator']} stream, only PCG64")
    inner = state["state"]
    words = [*divmod(inner["state"], _WORD), *divmod(inner["inc"], _WORD)]
    return np.array([*words, state["has_uint32"], state["uinteger"]], np.uint64)


def restore_generator(generator: np.random.Generator, state: NDArray[np.generic]) -> None:
    """Puts a PCG64 generator where `generator_state` found one, by its array of shape (6,)."""
    words = [int(word) for word in state.tolist()]
    generator.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": words[0] * _WORD + words[1], "inc": words[2] * _WORD + words[3]},
        "has_uint32": words[4],
        "uinteger": words[5],
    }
