"""Replay: one packed float32 row per transition, in a ring of fixed capacity."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent.networks.mlp import FloatArray


class RowLayout:
    """Where the fields of a transition lie in its row.

    A row is (observation, next observation, action, reward, terminal). Actions are exact in float32
    up to 2**24; terminal is 1 or 0.
    """

    def __init__(self, inputs: int) -> None:
        """Lays out transitions with observations of `inputs` numbers."""
        self.inputs = inputs
        self.action, self.reward, self.terminal = 2 * inputs, 2 * inputs + 1, 2 * inputs + 2
        self.width = 2 * inputs + 3

    def pack(
        self,
        observations: ArrayLike,
        actions: ArrayLike,
        rewards: ArrayLike,
        next_observations: ArrayLike,
        terminal: ArrayLike,
        out: FloatArray,
    ) -> None:
        """Writes transitions into the rows `out`, shape (n, width).

        Observations have shape (n, inputs), all else (n,).
        """
        out[:, : self.inputs] = observations
        out[:, self.inputs : self.action] = next_observations
        out[:, self.action] = actions
        out[:, self.reward] = rewards
        out[:, self.terminal] = terminal

    def unpack(
        self, rows: FloatArray
    ) -> tuple[FloatArray, NDArray[np.int64], FloatArray, FloatArray, NDArray[np.bool_]]:
        """Reads transitions from rows of shape (n, width), in the order in which `pack` takes."""
        return (
            rows[:, : self.inputs],
            rows[:, self.action].astype(np.int64),
            rows[:, self.reward],
            rows[:, self.inputs : self.action],
            rows[:, self.terminal] != 0,
        )


class Replay:
    """One agent's ring of transitions: the newest overwrites the oldest.

    The memory is reserved at once and not touched, so pages that no transition has reached cost
    nothing. The ring's position follows from the number of transitions ever added.
    """

    def __init__(self, capacity: int, width: int) -> None:
        """Reserves room for `capacity` rows of `width` numbers."""
        self.capacity = capacity
        self.added = 0
        self._rows: FloatArray = np.empty((capacity, width), np.float32)

    def __len__(self) -> int:
        """Transitions held now."""
        return min(self.added, self.capacity)

    def add(self, row: FloatArray) -> None:
        """Stores one transition, shape (width,)."""
        self._rows[self.added % self.capacity] = row
        self.added += 1

    def extend(self, rows: FloatArray) -> None:
        """Stores transitions in order, shape (m, width), of which the newest count."""
        start = self.added + max(len(rows) - self.capacity, 0)
        self.added += len(rows)
        self._rows[np.arange(start, self.added) % self.capacity] = rows[start - self.added :]

    def sample(self, generator: np.random.Generator, out: FloatArray) -> None:
        """Draws transitions uniformly, with replacement, into `out`, shape (batch, width)."""
        places: NDArray[np.float64] = generator.random((out.shape[0],))
        places *= len(self)
        # "clip" spares a copy; no place can lie outside, as random() stays below 1.
        self._rows.take(places.astype(np.intp), axis=0, out=out, mode="clip")

    def rows(self) -> FloatArray:
        """A copy of the filled part in memory order, shape (len, width)."""
        return self._rows[: len(self)].copy()

    def restore(self, rows: NDArray[np.generic], added: int) -> None:
        """Takes back what `rows` gave and the number of transitions ever added.

        Raises:
            ValueError: the rows are not those of a replay of this size.
        """
        if rows.shape != (min(added, self.capacity), self._rows.shape[1]):
            raise ValueError(
                f"a replay of {self.capacity} x {self._rows.shape[1]} cannot take rows of shape "
                f"{rows.shape} after {added} transitions"
            )
        self._rows[: len(rows)] = rows
        self.added = added
