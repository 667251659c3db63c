"""Which uploads the server hears."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.exchange.facts import WindowFacts

Weights = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Heard:
    """The uploads that take part in a window's average.

    Attributes:
        robots: whose they are, ascending, shape (H,).
        rows: their weights, shape (H, 2, P).
    """

    robots: NDArray[np.intp]
    rows: Weights


class Reception:
    """Hears everybody."""

    def heard(self, window: int, given: Weights, rows: Weights, facts: WindowFacts) -> Heard:
        """Those of a window's uploads that count.

        Args:
            window: the window's number.
            given: what each robot started the window from, shape (K, 2, P).
            rows: what each has sent, shape (K, 2, P).
            facts: of the window.
        """
        return Heard(np.arange(len(rows)), rows)
