"""The server's end of the link over TCP: a fleet whose robots are elsewhere."""

import socket
import ssl
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from lockstep.acceptor import Acceptor, RoundCredentials
from lockstep.client_slots import BlockStats, ClientSlot
from lockstep.errors import FrameError, LinkError
from lockstep.frames import actions_in, decode, encode, step_frame
from lockstep.messages import (
    PLAIN,
    Expect,
    Layout,
    Payload,
    Weights,
    checked_download,
    checked_model,
    checked_updates,
    checked_upload,
    of_block,
    robot_count,
)
from lockstep.server_round import ServerRound


class LinkServer:
    """Listens for the robots' clients and, once a round is open, drives them as a `Fleet`.

    A round is opened with `admit`, begins with `wait_connected` and ends with a step that expects
    `END_ROUND`, with the next `admit`, or with `close`. Pending connections are heard on a thread
    of their own; everything else happens in the caller's, which must be one at a time.

    Attributes:
        address: host, as it was given, and port.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 0,
        *,
        fingerprint: str,
        timeout_s: float,
        handshake_s: float = 5.0,
        server_context: ssl.SSLContext | None = None,
        layout: Layout = PLAIN,
    ) -> None:
        """Listen.

        Args:
            host: address to listen on.
            port: 0 picks a free one, see `address`.
            fingerprint: of the software; clients must have the same.
            timeout_s: the longest wait for an answer, in s.
            handshake_s: what a pending connection has to say hello, in s.
            server_context: for TLS; none, no TLS.
            layout: of the steps' records.

        Raises:
            LinkError: the address cannot be listened on.
        """
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            listener = socket.create_server((host, port), family=family, backlog=128)
        except (OSError, OverflowError) as error:
            raise LinkError(f"cannot listen on {host}:{port}: {error}") from error
        self.address = (host, int(listener.getsockname()[1]))
        self._fingerprint, self._timeout_s = fingerprint, timeout_s
        self._stats: dict[tuple[int, ...], BlockStats] = {}
        self._round: ServerRound | None = None
        self._robots, self._parameters, self._layout = 0, 0, layout
        self._acceptor = Acceptor(listener, handshake_s, server_context)
        self._acceptor.start()

    def admit(
        self,
        blocks: Sequence[Sequence[int]],
        tokens: Mapping[int, str],
        weights_shape: tuple[int, int],
    ) -> None:
        """Open a round; the one before, if any, is over, and its connections are closed.

        Args:
            blocks: the robots of each client; together 0..K-1.
            tokens: a secret for each robot, for this round only.
            weights_shape: (2, P).
        """
        robots = robot_count(blocks)
        if missing := [robot for robot in range(robots) if not tokens.get(robot)]:
            raise ValueError(f"no token for robots {missing}")
        self._part("a new round has begun")
        self._robots, self._parameters = robots, weights_shape[1]
        slots = []
        each = [tuple(block) for block in blocks]
        for block in each:
            stats = self._stats.setdefault(block, BlockStats())
            slots.append(ClientSlot(block, self._parameters, self._layout, stats))
        admission = RoundCredentials(self._fingerprint, tuple(each), dict(tokens))
        self._round = ServerRound(admission, slots, self._acceptor, self._timeout_s)
        self._acceptor.admission = admission

    def wait_connected(self, deadline_s: float, poll: Callable[[], None] | None = None) -> None:
        """Wait until all clients of the round are connected, for `deadline_s` seconds at most.

        `poll` is called about every 0.2 s; what it raises ends the wait.

        Raises:
            LinkTimeout: the deadline has passed; it names the robots that did not come.
            RobotLost, RobotFailed: one that had come is gone again.
        """
        self._open.fill(deadline_s, poll)

    def free(self) -> list[tuple[int, ...]]:
        """The blocks of the round whose client is not connected, as far as has been noticed."""
        return [slot.block for slot in self._open.free()]

    def renew(self, block: tuple[int, ...], tokens: Mapping[int, str]) -> None:
        """Let a block's robots in with these tokens only: a client that has older ones is out."""
        self._open.renew(block, tokens)

    def halt(self) -> list[int]:
        """Make all clients, which must be connected, drop what is under way.

        Returns:
            The windows, ascending, of which all robots have a checkpoint.

        Raises:
            RobotLost, RobotFailed, LinkTimeout: one is gone, or does not answer.
        """
        return self._open.halt()

    def kept(self) -> dict[tuple[int, ...], frozenset[int]]:
        """The windows of which each client has its robots' checkpoints, as `halt` has found."""
        return {block: slot.windows for block, slot in self._open.slots.items()}

    def begin(self, window: int, model: NDArray[np.float32] | None) -> None:
        """See `Fleet.begin`; once all clients are connected, whatever was under way."""
        if model is not None:
            checked_model(model, self._robots, self._parameters)
        self._open.begin(window, model)

    def send_step(self, tick: int, window: int, expect: Expect, updates: np.ndarray) -> None:
        """See `Fleet.send_step`."""
        current = self._open
        checked_updates(updates, self._robots, self._layout)
        current.protocol.on_step(tick, window, expect)
        for slot in current.slots.values():
            frame = step_frame(tick, window, expect, updates[slot.rows].tobytes(), slot.count)
            current.send(slot, frame, awaited=expect is not Expect.END_ROUND)

    def actions(self, tick: int) -> NDArray[np.int32]:
        """See `Fleet.actions`."""
        current = self._open
        current.protocol.on_call("actions", tick)
        result = np.empty(self._robots * self._layout.worlds, np.int32)

        def accept(slot: ClientSlot, frame: memoryview) -> None:
            result[slot.rows] = actions_in(frame, tick, slot.count)

        current.gather(accept)
        return result

    def upload(self, window: int) -> Payload:
        """See `Fleet.upload`."""
        current = self._open
        current.protocol.on_call("upload", window)
        packed = self._layout.upload
        shape, kind = ((packed,), np.uint8) if packed else ((2, self._parameters), np.float32)
        result: Payload = np.empty((self._robots, *shape), kind)

        def accept(slot: ClientSlot, frame: memoryview) -> None:
            message = decode(frame)
            if not isinstance(message, Weights) or message.window != window:
                raise FrameError(
                    f"{type(message).__name__} where weights of window {window} are due"
                )
            given, count = message.weights, len(slot.block)
            try:
                result[slot.robots] = checked_upload(given, count, self._parameters, self._layout)
            except ValueError as error:
                raise FrameError(str(error)) from error

        current.gather(accept)
        return result

    def download(self, window: int, weights: Payload) -> None:
        """See `Fleet.download`."""
        current = self._open
        checked_download(weights, self._robots, self._parameters, self._layout)
        current.protocol.on_call("download", window)
        frame = encode(Weights(window, weights)) if weights.ndim < 3 else b""
        for slot in current.slots.values():
            own = frame or encode(Weights(window, of_block(weights, slot.robots)))
            current.send(slot, own, awaited=False)

    def stats(self) -> dict[tuple[int, ...], BlockStats]:
        """What each client has cost so far, over all rounds: bytes, frames, seconds waited."""
        return dict(self._stats)

    def close(self, reason: str = "the server has closed the link") -> None:
        """End the round with a reason for the clients, and stop listening."""
        self._part(reason)
        self._acceptor.shut()

    @property
    def _open(self) -> ServerRound:
        """The round that is open."""
        if self._round is None:
            raise LinkError("no round is open: call admit first")
        return self._round

    def _part(self, reason: str) -> None:
        """End the round, if there is one."""
        self._acceptor.admission = None
        if self._round is not None:
            self._round.part(reason)
            self._round = None
