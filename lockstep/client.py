"""The client's end of the link over TCP: serves a handler's robots to the server."""

from __future__ import annotations

import logging
import socket
import ssl
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from lockstep.errors import Disconnected, FrameError, LinkTimeout, Refused, ServerLost, described
from lockstep.frame_stream import FrameStream, prepare
from lockstep.frames import decode, encode
from lockstep.interface import Robots
from lockstep.messages import (
    PLAIN,
    VERSION,
    Abort,
    Ack,
    Actions,
    Expect,
    Failure,
    Hello,
    Layout,
    Message,
    Payload,
    Rejection,
    Restore,
    Step,
    Weights,
    Welcome,
    checked_actions,
    checked_download,
    checked_model,
    checked_upload,
)
from lockstep.wire_format import TEXT_SIZE, model_size, step_size

log = logging.getLogger(__name__)
LINGER_S = 1.0
"""How long a client that has said why it stops waits for the server to close."""


def serve(
    address: tuple[str, int],
    robots: Sequence[int],
    tokens: Sequence[str],
    handler: Robots,
    *,
    fingerprint: str,
    timeout_s: float,
    n_parameters: int,
    idle_timeout_s: float | None = None,
    reconnect_timeout_s: float = 0.0,
    client_context: ssl.SSLContext | None = None,
    layout: Layout = PLAIN,
) -> None:
    """Serve one round: returns once the handler has taken a step that expects `END_ROUND`.

    Args:
        address: host and port of the server.
        robots: the robots that the handler holds, in its order.
        tokens: a secret for each of them, in the same order.
        handler: the robots.
        fingerprint: of the software; the server must have the same.
        timeout_s: the longest wait for a connection and a welcome, in s.
        n_parameters: P, of one network.
        idle_timeout_s: the longest silence after that, in s; `timeout_s` if None. The server is
            silent while other clients join and while it evaluates; if it dies, that is noticed at
            once.
        reconnect_timeout_s: how long to try to come back where the connection breaks, in s; 0 does
            not try. A server that has died is not waited for: its machine refuses the connection.
        client_context: for TLS; none, no TLS.
        layout: of the steps' records.

    Raises:
        Refused: the server does not let this client in.
        ServerLost: the server has gone, or never came.
        LinkTimeout: the server has said nothing for that long.
        FrameError: the server has said what it must not.
    """
    hello = Hello(VERSION, fingerprint, list(robots), list(tokens))
    sock = _connected(address, timeout_s, client_context)
    while True:
        try:
            line = _Line(sock, handler, len(robots), n_parameters, layout)
            line.enter(hello, timeout_s)
            line.wait_up_to(timeout_s if idle_timeout_s is None else idle_timeout_s)
            line.attend()
            return
        except Disconnected as error:
            if not reconnect_timeout_s:
                raise
            log.warning("%s; coming back", error)
        finally:
            sock.close()
        sock = _connected(address, reconnect_timeout_s, client_context, if_refused=False)


class _Line:
    """The conversation of n robots with the server over one connection."""

    def __init__(
        self, sock: socket.socket, handler: Robots, robots: int, n_parameters: int, layout: Layout
    ) -> None:
        longest = max(step_size(robots, layout), model_size(robots, n_parameters, layout))
        self._stream = FrameStream(sock, max(TEXT_SIZE, longest))
        self._handler, self._robots, self._parameters = handler, robots, n_parameters
        self._layout = layout

    def enter(self, hello: Hello, timeout_s: float) -> None:
        """Say hello and hear the welcome."""
        self.wait_up_to(timeout_s)
        self._send(hello)
        reply = self._recv()
        if isinstance(reply, Rejection):
            raise Refused(reply.reason)
        if not isinstance(reply, Welcome):
            raise FrameError(f"{type(reply).__name__} where a welcome is due")

    def wait_up_to(self, timeout_s: float) -> None:
        """Bear this much silence from now on."""
        self._timeout_s = timeout_s
        self._stream.set_timeout(timeout_s)

    def attend(self) -> None:
        """Serve steps until the end of the round; errors here are reported to the server.

        SIGTERM is reported as a lost connection, not as an error, so that the robot may reconnect.
        """
        try:
            self._converse()
        except (ServerLost, SystemExit, KeyboardInterrupt):
            raise
        except BaseException as error:
            self._stream.finish(encode(Failure(described(error))), linger_s=LINGER_S)
            raise

    def _converse(self) -> None:
        uploaded = -1  # the window whose download may come now
        while True:
            message = self._recv()
            if isinstance(message, Weights) and message.window == uploaded:
                weights = message.weights
                with _due():
                    checked_download(weights, self._robots, self._parameters, self._layout)
                self._handler.download(message.window, weights)
                uploaded = -1
                continue
            uploaded = -1
            if isinstance(message, Step):
                rows, due = len(message.updates), self._robots * self._layout.worlds
                if rows != due:
                    raise FrameError(f"a step of {rows} records, not {due}")
                actions = self._handler.step(message)
                if message.expect is Expect.END_ROUND:
                    return
                if message.expect is Expect.ACTIONS:
                    self._send(Actions(message.tick, checked_actions(actions, rows)))
                else:
                    uploaded = message.window
                    self._send(Weights(uploaded, self._uploaded()))
            elif isinstance(message, Abort):
                self._send(Ack(message.number, tuple(self._handler.windows())))
            elif isinstance(message, Restore):
                if message.model is not None:
                    with _due():
                        checked_model(message.model, self._robots, self._parameters)
                self._handler.begin(message.window, message.model)
                self._send(Ack(message.number))
            elif isinstance(message, Failure):
                raise ServerLost(f"the server has stopped: {message.reason}")
            else:
                raise FrameError(f"{type(message).__name__} out of turn")

    def _uploaded(self) -> Payload:
        weights = self._handler.upload()
        return checked_upload(weights, self._robots, self._parameters, self._layout)

    def _recv(self) -> Message:
        """The server's next message; its arrays are the caller's to keep."""
        try:
            frame = self._stream.receive()
        except TimeoutError:
            frame = None
        except (OSError, EOFError) as error:
            raise Disconnected(f"the server has gone: {described(error)}") from error
        if frame is None:
            raise LinkTimeout(f"no word from the server for {self._timeout_s:g} s")
        return decode(bytearray(frame), self._layout)

    def _send(self, message: Message) -> None:
        try:
            self._stream.send(encode(message), self._timeout_s)
        except OSError as error:
            raise Disconnected(f"the server has gone: {described(error)}") from error


@contextmanager
def _due() -> Iterator[None]:
    """Weights of the server that are not as was agreed make its frame a wrong one."""
    try:
        yield
    except (TypeError, ValueError) as error:
        raise FrameError(str(error)) from error


def _connected(
    address: tuple[str, int],
    timeout_s: float,
    context: ssl.SSLContext | None,
    *,
    if_refused: bool = True,
) -> socket.socket:
    """A connection to the server, tried again until the deadline, also if it is refused or not."""
    deadline = time.monotonic() + timeout_s
    pause = 0.05
    while True:
        rest = max(0.05, deadline - time.monotonic())
        try:
            sock = socket.create_connection(address, timeout=rest)
            break
        except OSError as error:
            refused = isinstance(error, ConnectionRefusedError) and not if_refused
            if refused or time.monotonic() + pause >= deadline:
                where = f"{address[0]}:{address[1]}"
                raise ServerLost(f"no connection to {where}: {described(error)}") from error
            log.debug("no connection yet: %s", described(error))
        time.sleep(pause)
        pause = min(1.0, 2 * pause)
    sock.settimeout(timeout_s)
    prepare(sock)
    if context is None:
        return sock
    try:
        return context.wrap_socket(sock, server_hostname=address[0])
    except OSError as error:
        sock.close()
        raise ServerLost(f"no TLS with the server: {described(error)}") from error
