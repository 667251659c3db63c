"""The link within one process: the same conversation, as calls."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from lockstep.errors import LinkError, RobotFailed, described
from lockstep.interface import ProtocolState, Robots
from lockstep.messages import (
    PLAIN,
    Expect,
    Layout,
    Payload,
    Step,
    checked_actions,
    checked_download,
    checked_updates,
    checked_upload,
    of_block,
    robot_count,
)


class InProcessFleet:
    """A `Fleet` of handlers in this process, called one after the other.

    Handlers see the same calls as over TCP. What one of them raises comes out as `RobotFailed`,
    at once and not only where its answer is due. No Flower reply carries the weights at the end of
    a round, so they may be taken there, too.
    """

    def __init__(
        self, handlers: Sequence[tuple[tuple[int, ...], Robots]], layout: Layout = PLAIN
    ) -> None:
        """A fleet before its first step.

        Args:
            handlers: each with the robots that it holds; together 0..K-1.
            layout: of the steps' records.
        """
        blocks = [block for block, _ in handlers]
        self._robots, self._layout = robot_count(blocks), layout
        self._handlers = [(block, layout.rows_of(block), handler) for block, handler in handlers]
        self._protocol = ProtocolState()
        self._answers: list[NDArray[np.int32]] = []
        self._parameters: int | None = None
        self._closed = self._has_ended = False

    def send_step(self, tick: int, window: int, expect: Expect, updates: np.ndarray) -> None:
        """See `Fleet.send_step`."""
        self._check_open()
        checked_updates(updates, self._robots, self._layout)
        self._protocol.on_step(tick, window, expect)
        self._has_ended = expect is Expect.END_ROUND
        answers = self._answers = []
        for block, rows, handler in self._handlers:
            step = Step(tick, window, expect, updates[rows].copy())
            with self._failing(block):
                actions = handler.step(step)
                if expect is Expect.ACTIONS:
                    answers.append(checked_actions(actions, len(step.updates)))

    def actions(self, tick: int) -> NDArray[np.int32]:
        """See `Fleet.actions`."""
        self._check_open()
        self._protocol.on_call("actions", tick)
        result = np.empty(self._robots * self._layout.worlds, np.int32)
        for (_, rows, _), given in zip(self._handlers, self._answers, strict=True):
            result[rows] = given
        return result

    def upload(self, window: int) -> Payload:
        """See `Fleet.upload`."""
        self._check_open()
        if not self._has_ended:
            self._protocol.on_call("upload", window)
        parts = []
        for block, _, handler in self._handlers:
            with self._failing(block):
                weights = handler.upload()
                if self._parameters is None and not self._layout.upload:
                    self._parameters = weights.shape[-1]
                parameters = self._parameters or 0
                parts.append(checked_upload(weights, len(block), parameters, self._layout))
        result = np.empty((self._robots, *parts[0].shape[1:]), parts[0].dtype)
        for (block, _, _), part in zip(self._handlers, parts, strict=True):
            result[list(block)] = part
        return result

    def download(self, window: int, weights: Payload) -> None:
        """See `Fleet.download`."""
        self._check_open()
        checked_download(weights, self._robots, self._parameters or weights.shape[-1], self._layout)
        self._protocol.on_call("download", window)
        for block, _, handler in self._handlers:
            with self._failing(block):
                handler.download(window, of_block(weights, block))

    def begin(self, window: int, model: NDArray[np.float32] | None) -> None:
        """See `Fleet.begin`."""
        self._check_open()
        self._protocol, self._has_ended = ProtocolState(), False
        for block, _, handler in self._handlers:
            with self._failing(block):
                handler.begin(window, None if model is None else of_block(model, block))

    def close(self) -> None:
        """See `Fleet.close`."""
        self._closed = True

    @contextmanager
    def _failing(self, block: tuple[int, ...]) -> Iterator[None]:
        """Whatever a handler raises is its robots' failure."""
        try:
            yield
        except Exception as error:
            raise RobotFailed(block, str(self._protocol), described(error)) from error

    def _check_open(self) -> None:
        if self._closed:
            raise LinkError("the link is closed")
