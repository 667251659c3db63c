"""n-step returns: the transitions of several slots stored as one.

Sutton, "Learning to predict by the methods of temporal differences", Machine Learning 3 (1988);
with DQN: Hessel et al., "Rainbow", AAAI 2018. The rewards between are those of what the agent
then did, exploration included, with no correction for it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.networks.mlp import FloatArray
from agent.replay.uniform import RowLayout


class NStepBuilder:
    """One agent's newest transitions, which wait until n slots have passed since the first.

    A transition that leaves the window has the reward sum_i discount^i r_i of the m slots that it
    covers and the last one's next state, whose value counts discount^m. m is n, and fewer where an
    episode ends: with arrival, after which nothing is bootstrapped, or cut off at T_max, where the
    last state's value is. No message says that an episode was cut off: it shows in the next
    transition, which does not start where the last one led, and what was cut off waits until then.
    """

    def __init__(self, layout: RowLayout, steps: int, discount: float) -> None:
        """An empty window of n `steps`, for rows of a layout."""
        self._layout, self._steps, self._discount = layout, steps, discount
        self._rows: list[FloatArray] = []

    def add(self, row: FloatArray) -> list[FloatArray]:
        """Takes a transition of one slot, shape (width,); returns those that are ready to store."""
        ready = []
        if self._rows and not self._leads_to(row):
            ready += self._all()
        self._rows.append(row.copy())
        if row[self._layout.terminal]:
            ready += self._all()
        elif len(self._rows) == self._steps:
            ready.append(self._first())
        return ready

    def rows(self) -> FloatArray:
        """A copy of what waits, oldest first, shape (below n, width)."""
        return np.array(self._rows, np.float32).reshape(-1, self._layout.width)

    def restore(self, rows: NDArray[np.generic]) -> None:
        """Takes back what `rows` gave."""
        self._rows = list(rows.astype(np.float32))

    def _leads_to(self, row: FloatArray) -> bool:
        """Whether the newest transition ended in the state in which this one starts."""
        inputs, action = self._layout.inputs, self._layout.action
        return np.array_equal(self._rows[-1][inputs:action], row[:inputs])

    def _all(self) -> list[FloatArray]:
        """Takes out all that wait, oldest first, each up to the newest's end."""
        return [self._first() for _ in range(len(self._rows))]

    def _first(self) -> FloatArray:
        """Takes out the oldest transition, with the return of all that wait."""
        layout, last = self._layout, self._rows[-1]
        discounts = self._discount ** np.arange(len(self._rows))
        rewards = np.array([row[layout.reward] for row in self._rows], np.float64)
        first = self._rows.pop(0).copy()
        first[layout.inputs : layout.action] = last[layout.inputs : layout.action]
        first[layout.reward] = discounts @ rewards
        first[layout.terminal] = 1 - (1 - last[layout.terminal]) * discounts[-1]
        return first
