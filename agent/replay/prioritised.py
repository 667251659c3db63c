"""Prioritised replay: transitions that surprise are drawn more often, and weigh less for it.

Schaul, Quan, Antonoglou and Silver, "Prioritized experience replay", ICLR 2016: its proportional
variant, with a constant beta. Sums are taken anew at every draw, which up to some ten thousand
transitions costs less than keeping a tree in NumPy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.config import PriorityConfig
from agent.networks.mlp import FloatArray
from agent.replay.uniform import Replay

LEAST_ERROR = 1e-3
"""Added to every error, in scaled reward: what holds no surprise is drawn at times, too."""


@dataclass(frozen=True)
class ImportanceWeights:
    """What each sample of a batch weighs in the loss, and where its error is put.

    Attributes:
        importance: the weights, shape (n, B).
        error: Q(s, a) - y, shape (n, B).
    """

    importance: FloatArray
    error: FloatArray

    def weigh(self, error: FloatArray, losses: FloatArray, grad: FloatArray) -> None:
        """Notes the errors; multiplies losses and slopes in place, all of shape (n, B)."""
        np.copyto(self.error, error)
        losses *= self.importance
        grad *= self.importance

    def part(self, start: int, stop: int) -> ImportanceWeights:
        """That of the agents [start, stop)."""
        return ImportanceWeights(self.importance[start:stop], self.error[start:stop])


class PrioritisedReplay(Replay):
    """A ring of transitions, drawn in proportion to (|error| + a little)^alpha.

    New transitions count as the most surprising one so far, so that each is drawn soon.
    """

    def __init__(
        self,
        capacity: int,
        width: int,
        config: PriorityConfig,
        importance: FloatArray,
        error: FloatArray,
    ) -> None:
        """Reserves room for `capacity` rows of `width` numbers.

        Args:
            capacity: transitions.
            width: of a row.
            config: alpha and beta.
            importance: where a batch's weights go, shape (batch,).
            error: where a batch's errors stand once it was learned from, shape (batch,).
        """
        super().__init__(capacity, width)
        self._config, self._importance, self._error = config, importance, error
        self._shares = np.zeros(capacity)
        self._largest = 1.0
        self._drawn = np.zeros(0, np.intp)

    def add(self, row: FloatArray) -> None:
        """Stores one transition, shape (width,)."""
        self._shares[self.added % self.capacity] = self._largest
        super().add(row)

    def extend(self, rows: FloatArray) -> None:
        """Stores transitions in order, shape (m, width)."""
        self._shares[np.arange(self.added, self.added + len(rows)) % self.capacity] = self._largest
        super().extend(rows)

    def sample(self, generator: np.random.Generator, out: FloatArray) -> None:
        """Draws transitions i with chance P(i), with replacement, and sets their importance.

        That is (N P(i))^-beta over the largest in the batch, of N transitions held.
        """
        held = len(self)
        sums = np.cumsum(self._shares[:held])
        places = np.searchsorted(sums, generator.random(len(out)) * sums[-1], side="right")
        self._drawn = np.minimum(places, held - 1)  # rounding may reach the very end
        self._rows.take(self._drawn, axis=0, out=out, mode="clip")
        chance = self._shares[self._drawn] / sums[-1]
        weight = (held * chance) ** -self._config.beta
        self._importance[:] = weight / weight.max()

    def update_priorities(self) -> None:
        """Takes the errors of the batch drawn last as its new priorities."""
        shares = (np.abs(self._error.astype(np.float64)) + LEAST_ERROR) ** self._config.alpha
        self._shares[self._drawn] = shares
        self._largest = max(self._largest, float(shares.max()))

    def extra_state(self) -> dict[str, NDArray[np.generic]]:
        """What the chances are in proportion to, and the largest so far as the last number."""
        return {"priorities": np.append(self._shares[: len(self)], self._largest)}

    def restore_marks(self, state: Mapping[str, NDArray[np.generic]]) -> None:
        """Takes back what `marks` gave, once the rows are restored."""
        *shares, self._largest = state["priorities"].tolist()
        self._shares[: len(shares)] = shares
