"""A vector of numbers in a fixed number of bytes, and what a receiver makes of it.

The numbers come in blocks: the weights or the bias of one layer each. Layers differ in scale, so
quantisers have a scale for each block. Whoever unpacks trusts nothing: bytes that no packer makes
are a ValueError.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

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
        """What a receiver makes of it, shape (n,).

        Raises:
            ValueError: no packer makes such bytes.
        """
        ...


def build_packer(kind: str, keep: float, blocks: Sequence[int]) -> Packer:
    """Makes the packer of a kind, as ``federation.compression`` has it, for blocks of numbers.

    ``keep`` is the share of the numbers that ``topk`` sends.
    """
    if kind == "none":
        return Floats(sum(blocks))
    if kind == "topk":
        return TopK(sum(blocks), keep)
    return Signs(blocks) if kind == "q1" else Quantiser(blocks, int(kind[1:]))


class Floats:
    """Numbers as they are, four bytes each."""

    def __init__(self, numbers: int) -> None:
        self.size = 4 * numbers

    def pack(self, values: Weights) -> Bytes:
        """See ``Packer.pack``."""
        return np.ascontiguousarray(values, "<f4").view(np.uint8)

    def unpack(self, packed: Bytes) -> Weights:
        """See ``Packer.unpack``."""
        return _numbers(packed, "<f4").astype(np.float32)


class Scaled:
    """A float32 scale for each block of numbers, and then a few bits for each number."""

    def __init__(self, blocks: Sequence[int], bits: int) -> None:
        self._blocks = np.array(blocks, np.int64)
        self._starts = np.cumsum(self._blocks) - self._blocks
        self._head = 4 * len(blocks)
        self.size = self._head + -(-int(self._blocks.sum()) * bits // 8)

    def _joined(self, scales: Weights, body: Bytes) -> Bytes:
        """What is packed: the scales of the blocks, and the numbers."""
        return np.concatenate([np.ascontiguousarray(scales, "<f4").view(np.uint8), body])

    def _parted(self, packed: Bytes) -> tuple[Weights, Bytes]:
        """The scale of each number, shape (n,), checked, and what comes after the head."""
        scales = _numbers(packed[: self._head], "<f4").astype(np.float32)
        if len(wrong := scales[~(np.isfinite(scales) & (scales >= 0))]):
            raise ValueError(f"a scale is {wrong[0]:g}, which is no finite number from 0 up")
        return np.repeat(scales, self._blocks), packed[self._head :]


class Quantiser(Scaled):
    """Numbers rounded to the nearest of 255 steps, or of 15, from -s to s; in 8 bits, or in 4.

    The error is at most half a step: s / 254 with eight bits, s / 14 with four, where s is the
    largest magnitude of the number's block.
    """

    def __init__(self, blocks: Sequence[int], bits: int) -> None:
        super().__init__(blocks, bits)
        self._bits, self._most = bits, 2 ** (bits - 1) - 1

    def pack(self, values: Weights) -> Bytes:
        """See ``Packer.pack``."""
        largest = np.maximum.reduceat(np.abs(values), self._starts)
        scales = (largest / np.float32(self._most)).astype(np.float32)
        scale = np.repeat(scales, self._blocks)
        with np.errstate(invalid="ignore"):  # a NaN is seen by whoever unpacks its scale
            steps = np.rint(np.divide(values, scale, out=np.zeros_like(values), where=scale != 0))
        whole = np.clip(np.nan_to_num(steps), -self._most, self._most).astype(np.int8)
        return self._joined(scales, whole.view(np.uint8) if self._bits == 8 else _halved(whole))

    def unpack(self, packed: Bytes) -> Weights:
        """See ``Packer.unpack``."""
        scale, rest = self._parted(packed)
        steps = rest.view(np.int8) if self._bits == 8 else _doubled(rest, len(scale))
        with np.errstate(over="ignore"):  # of a scale that no honest robot has
            return steps.astype(np.float32) * scale


class Signs(Scaled):
    """The sign of each number, and the mean magnitude of its block (Karimireddy et al., 2019).

    With error feedback this scaled sign converges at the rate of plain SGD (arXiv:1901.09847,
    Theorem II); without, it need not.
    """

    def __init__(self, blocks: Sequence[int]) -> None:
        super().__init__(blocks, bits=1)

    def pack(self, values: Weights) -> Bytes:
        """See ``Packer.pack``."""
        sums = np.add.reduceat(np.abs(values).astype(np.float64), self._starts)
        return self._joined((sums / self._blocks).astype(np.float32), np.packbits(values >= 0))

    def unpack(self, packed: Bytes) -> Weights:
        """See ``Packer.unpack``."""
        scale, rest = self._parted(packed)
        return np.where(np.unpackbits(rest, count=len(scale)) != 0, scale, -scale)


class TopK:
    """The numbers of largest magnitude with their places; all others are 0 (Stich et al., 2018).

    Of equal magnitudes the first is sent (arXiv:1809.07599). At least one is.
    """

    def __init__(self, numbers: int, keep: float) -> None:
        self._all, self._kept = numbers, max(1, round(keep * numbers))
        self._place = np.dtype("<u2" if numbers <= 2**16 else "<u4")
        self.size = self._kept * (self._place.itemsize + 4)

    def pack(self, values: Weights) -> Bytes:
        """See ``Packer.pack``."""
        magnitude = np.nan_to_num(np.abs(values), nan=np.inf)  # a NaN is for the receiver to see
        places = np.sort(np.argsort(-magnitude, kind="stable")[: self._kept])
        found = places.astype(self._place), values[places].astype("<f4")
        return np.concatenate([part.view(np.uint8) for part in found])

    def unpack(self, packed: Bytes) -> Weights:
        """See ``Packer.unpack``."""
        at = self._kept * self._place.itemsize
        places = _numbers(packed[:at], self._place).astype(np.int64)
        if places[-1] >= self._all or (np.diff(places) <= 0).any():
            raise ValueError(f"their places are not {self._kept} ascending ones below {self._all}")
        values = np.zeros(self._all, np.float32)
        values[places] = _numbers(packed[at:], "<f4")
        return values


def _numbers(packed: Bytes, kind: str | np.dtype[np.unsignedinteger]) -> NDArray[np.generic]:
    """Bytes read as numbers of a kind."""
    return np.ascontiguousarray(packed).view(kind)


def _halved(steps: NDArray[np.int8]) -> Bytes:
    """Steps from -7 to 7, two in a byte, the first one high."""
    even = np.zeros(len(steps) + len(steps) % 2, np.uint8)
    even[: len(steps)] = steps + 8
    return (even[::2] << 4 | even[1::2]).astype(np.uint8)


def _doubled(halves: Bytes, count: int) -> NDArray[np.int8]:
    """The inverse of ``_halved``."""
    return np.stack([halves >> 4, halves & 15], axis=-1).ravel()[:count].astype(np.int8) - 8
