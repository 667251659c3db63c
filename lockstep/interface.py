"""The two ends of the link, whatever lies between them."""

from collections.abc import Sequence
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from lockstep.errors import ProtocolError
from lockstep.messages import Expect, Payload, Step


class Robots(Protocol):
    """Client side: n robots with no loop of their own. What they are given is theirs to keep."""

    def step(self, step: Step) -> NDArray[np.int32] | None:
        """Learn from the outcome; answer int32, one a row, if the step wants actions, else None."""
        ...

    def upload(self) -> Payload:
        """Weights of each robot, as the layout says; called once in a window."""
        ...

    def download(self, window: int, weights: Payload) -> None:
        """Take the global model of a window, or each robot its own, as the layout says."""
        ...

    def windows(self) -> Sequence[int]:
        """Windows of which all these robots have a checkpoint, whole and unchanged."""
        ...

    def begin(self, window: int, model: NDArray[np.float32] | None) -> None:
        """Go to the state after a window, 0 being the start; then take plain weights, if any."""
        ...


class Fleet(Protocol):
    """Server side: all K robots, in robot order."""

    def send_step(self, tick: int, window: int, expect: Expect, updates: np.ndarray) -> None:
        """Send each robot its records of `updates`, (K E,); return at once where possible."""
        ...

    def actions(self, tick: int) -> NDArray[np.int32]:
        """The answers to the step of this tick, int32 (K E,), -1 where a robot is not driving."""
        ...

    def upload(self, window: int) -> Payload:
        """The weights after a window: plain (K, 2, P), or packed as the layout says."""
        ...

    def download(self, window: int, weights: Payload) -> None:
        """Give robots weights: plain (2, P) for all or (K, 2, P), or packed ones for all."""
        ...

    def begin(self, window: int, model: NDArray[np.float32] | None) -> None:
        """Send all robots to the state after a window, 0 being the start, with its model."""
        ...

    def close(self) -> None:
        """End the conversation."""
        ...


class ProtocolState:
    """Where a fleet's conversation is, so that both forms of the link keep the same order.

    `send_step(ACTIONS)`, `actions`; `send_step(WEIGHTS)`, `upload` and, if the server has a new
    model, `download`; `send_step(END_ROUND)`, and nothing more until the next round.
    """

    def __init__(self) -> None:
        """A conversation that has not begun."""
        self.tick = -1
        self.window = -1
        self._next = "send_step"

    def __str__(self) -> str:
        """For messages: which tick and window, or that there was no step yet."""
        if self.tick < 0:
            return "before the first step"
        return f"at tick {self.tick}, window {self.window}"

    def on_step(self, tick: int, window: int, expect: Expect) -> None:
        """A step goes out."""
        if self._next not in ("send_step", "download"):
            raise ProtocolError(f"a step for tick {tick} where {self._next} is due, {self}")
        self.tick, self.window = tick, window
        self._next = _AFTER[expect]

    def on_call(self, call: Literal["actions", "upload", "download"], number: int) -> None:
        """`actions` of a tick is called, or `upload` or `download` of a window."""
        kind, due = ("tick", self.tick) if call == "actions" else ("window", self.window)
        if call != self._next or number != due:
            raise ProtocolError(f"{call} of {kind} {number} where {self._next} is due, {self}")
        self._next = "download" if call == "upload" else "send_step"


_AFTER = {Expect.ACTIONS: "actions", Expect.WEIGHTS: "upload", Expect.END_ROUND: "a new round"}
