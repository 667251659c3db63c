"""Small-scale fading of the direct channels that is drawn anew in each slot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from env.arrays import Bools, Complexes, Floats, Ints
from env.radio.propagation import small_scale_fading


class SlotFading:
    """The factor on hbar in this slot, for B worlds of K robots (``channel.fading=slot``).

    Sources below are the streams of as many equal blocks of worlds.

    Args:
        los: whether each cell sees the access point, shape (cells,).
        rician_k_db: Rician factor of those that do, in dB.

    Attributes:
        factor: shape (B, K), once it is drawn.
    """

    def __init__(self, los: Bools, rician_k_db: float) -> None:
        self._los, self._rician_k_db = los, rician_k_db
        self.factor: Complexes = np.ones((0, 0), np.complex128)
        self._sources: Sequence[np.random.Generator] = ()

    def begin(self, cell: Ints, sources: Sequence[np.random.Generator]) -> None:
        """Draws an episode's first slot in cells, shape (B, K); the sources are those of all."""
        self._sources = sources
        self.draw(cell)

    def draw(self, cell: Ints) -> None:
        """Draws the next slot in cells, shape (B, K)."""
        self.factor = self._drawn(cell, self._sources)

    def redraw(self, worlds: Bools, cell: Ints, sources: Sequence[np.random.Generator]) -> None:
        """Draws the slot again in n of the worlds, shape (B,), in cells, shape (n, K)."""
        self.factor = self.factor.copy()  # whoever was given the array keeps what it held
        self.factor[worlds] = self._drawn(cell, sources)

    def _drawn(self, cell: Ints, sources: Sequence[np.random.Generator]) -> Complexes:
        blocks = zip(np.split(self._los[cell], len(sources)), sources, strict=True)
        drawn = [small_scale_fading(los, self._rician_k_db, source) for los, source in blocks]
        return np.concatenate(drawn)

    def state(self) -> Floats:
        """The factor's real and imaginary parts, shape (2, B, K)."""
        return np.stack([self.factor.real, self.factor.imag])

    def restore(self, state: Floats) -> None:
        """Takes back what ``state`` gave."""
        real, imaginary = state
        self.factor = real + 1j * imaginary
