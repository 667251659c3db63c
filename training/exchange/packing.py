"""Weights in fewer bytes: differences from what the receiver holds, packed, with error feedback.

What packing loses of a difference is added to the next one (Seide et al., 2014; Karimireddy et al.,
2019, arXiv:1901.09847), on either side: robots keep what the server has not heard yet, and the
server what robots have not.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from conf import Config

Weights = NDArray[np.float32]
Bytes = NDArray[np.uint8]


class Packer(Protocol):
    """A vector of numbers as a fixed number of bytes.

    Attributes:
        size: of what is packed, in bytes.
    """

    size: int

    def pack(self, values: Weights) -> Bytes:
        """Packs values of shape (n,) into shape (size,)."""
        ...

    def unpack(self, packed: Bytes) -> Weights:
        """What a receiver makes of it, shape (n,)."""
        ...


class Packing:
    """How a pair of networks is packed: as a difference, of both or of the online ones alone.

    Args:
        packer: of the numbers that are sent.
        parameters: P.
        targets: whether target networks are sent; without, receivers copy the online ones.
    """

    def __init__(self, packer: Packer, parameters: int, *, targets: bool) -> None:
        self._packer, self.targets, self.size = packer, targets, packer.size
        self.numbers = (2 if targets else 1) * parameters

    def difference(self, given: Weights, weights: Weights) -> Weights:
        """What is to be sent of weights whose receiver holds ``given``, shape (numbers,)."""
        return (weights - given).ravel()[: self.numbers]

    def pack(self, values: Weights) -> Bytes:
        """See ``Packer.pack``."""
        return self._packer.pack(values)

    def unpack(self, packed: Bytes) -> Weights:
        """See ``Packer.unpack``."""
        return self._packer.unpack(packed)

    def added(self, given: Weights, packed: Bytes) -> Weights:
        """What a receiver that holds ``given`` has then, both of shape (2, P)."""
        rows = given if self.targets else given[:1]
        found = rows + self._packer.unpack(packed).reshape(rows.shape)
        return np.ascontiguousarray(np.broadcast_to(found, given.shape), np.float32)


class PackedSender:
    """Sends networks packed and remembers what was lost on the way.

    Args:
        packing: how.
    """

    def __init__(self, packing: Packing) -> None:
        self._packing = packing
        self._lost: Weights = np.zeros(packing.numbers, np.float32)

    def send(self, given: Weights, weights: Weights) -> Bytes:
        """Packs weights for a receiver that holds ``given``, both of shape (2, P)."""
        wanted = self._packing.difference(given, weights) + self._lost
        packed = self._packing.pack(wanted)
        self._lost = wanted - self._packing.unpack(packed)
        return packed

    def state(self) -> dict[str, NDArray[Any]]:
        """What was lost so far."""
        return {"lost": self._lost}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave; nothing is a fresh sender."""
        lost = state.get("lost")
        self._lost = np.zeros_like(self._lost) if lost is None else np.array(lost, np.float32)


def packing(config: Config, parameters: int) -> tuple[Packing | None, Packing | None]:
    """How a run's weights are packed, up and down; None where they are sent as they are.

    Args:
        config: the run's configuration.
        parameters: P, of a robot's network.
    """
    chosen = config.federation.compression
    targets = chosen.targets == "averaged"
    up, down = (
        Packing(
            _packer(kind, chosen.keep, (2 if targets else 1) * parameters),
            parameters,
            targets=targets,
        )
        if kind != "none" or not targets
        else None
        for kind in (chosen.up, chosen.down)
    )
    return up, down


def _packer(kind: str, keep: float, numbers: int) -> Packer:
    if kind == "none":
        return Floats(numbers)
    return Quantiser(numbers, int(kind[1:]))


class Floats:
    """Numbers as they are, four bytes each."""

    def __init__(self, numbers: int) -> None:
        self.size = 4 * numbers

    def pack(self, values: Weights) -> Bytes:
        """See ``Packer.pack``."""
        return np.ascontiguousarray(values, "<f4").view(np.uint8)

    def unpack(self, packed: Bytes) -> Weights:
        """See ``Packer.unpack``."""
        return np.ascontiguousarray(packed).view("<f4").astype(np.float32)


class Quantiser:
    """Eight bits a number."""

    def __init__(self, numbers: int, bits: int) -> None:
        self.size = 4 + numbers

    def pack(self, values: Weights) -> Bytes:
        """See ``Packer.pack``."""
        scale = np.float32(np.abs(values).max(initial=0.0) / 127)
        steps = np.rint(values / scale) if scale > 0 else np.zeros_like(values)
        head = np.array([scale], "<f4").view(np.uint8)
        return np.concatenate([head, steps.astype(np.int8).view(np.uint8)])

    def unpack(self, packed: Bytes) -> Weights:
        """See ``Packer.unpack``."""
        scale = np.ascontiguousarray(packed[:4]).view("<f4")[0]
        return np.ascontiguousarray(packed[4:]).view(np.int8).astype(np.float32) * np.float32(scale)
