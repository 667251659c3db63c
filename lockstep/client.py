"""The client's end of the link over TCP: serves a handler's robots to the server."""

from __future__ import annotations

import logging
import socket
import ssl
import time
from collections.abc import Callable, Sequence
from typing import Any

from lockstep.errors import Disconnected, FrameError, LinkTimeout, Refused, ServerLost, described
from lockstep.frame_stream import FrameStream, prepare
from lockstep.frames import decode, encode
from lockstep.interface import Robots, answer
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
    Restore,
    Step,
    Weights,
    Welcome,
    checked_download,
    checked_model,
)
from lockstep.messages import Rejection as RefusedMessage
from lockstep.wire_format import TEXT_SIZE, model_size, step_size

log = logging.getLogger(__name__)


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
    """Serve one round: returns once the handler has taken the step that wants a FAREWELL.

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
    sock = _connected(address, timeout_s, client_context)
    while True:
        try:
            line = _entered(sock, robots, tokens, fingerprint, timeout_s, n_parameters, layout)
            line.wait_up_to(timeout_s if idle_timeout_s is None else idle_timeout_s)
            _attend(line, handler, len(robots), n_parameters)
            return
        except Disconnected as error:
            if not reconnect_timeout_s:
                raise
            log.warning("%s; coming back", error)
        finally:
            sock.close()
        sock = _connected(address, reconnect_timeout_s, client_context, if_refused=False)


def _entered(
    sock: socket.socket,
    robots: Sequence[int],
    tokens: Sequence[str],
    fingerprint: str,
    timeout_s: float,
    n_parameters: int,
    layout: Layout,
) -> _Line:
    """Say hello and hear the welcome."""
    hello = Hello(VERSION, fingerprint, list(robots), list(tokens))
    most = model_size(len(robots), n_parameters, layout)
    limit = max(TEXT_SIZE, step_size(len(robots), layout), most)
    line = _Line(FrameStream(sock, limit), timeout_s, layout)
    line.wait_up_to(timeout_s)
    line.send(encode(hello))
    answer = line.recv()
    if isinstance(answer, RefusedMessage):
        raise Refused(answer.reason)
    if not isinstance(answer, Welcome):
        raise FrameError(f"{type(answer).__name__} where a welcome is due")
    return line


class _Line:
    """Messages from and to the server, and what it means when they stop."""

    def __init__(self, stream: FrameStream, timeout_s: float, layout: Layout) -> None:
        """A line over a socket that has this timeout."""
        self.stream, self._timeout_s, self.layout = stream, timeout_s, layout

    def wait_up_to(self, timeout_s: float) -> None:
        """Bear this much silence from now on."""
        self._timeout_s = timeout_s
        self.stream.set_timeout(timeout_s)

    def recv(self) -> Message:
        """The server's next message; its arrays are the caller's to keep."""
        try:
            frame = self.stream.receive()
        except TimeoutError:
            frame = None
        except (OSError, EOFError) as error:
            raise Disconnected(f"the server has gone: {described(error)}") from error
        if frame is None:
            raise LinkTimeout(f"no word from the server for {self._timeout_s:g} s")
        return decode(bytearray(frame), self.layout)

    def send(self, frame: bytes) -> None:
        """Send a frame."""
        try:
            self.stream.send(frame, self._timeout_s)
        except OSError as error:
            raise Disconnected(f"the server has gone: {described(error)}") from error


def _attend(line: _Line, handler: Robots, count: int, n_parameters: int) -> None:
    """Serve steps until the end of the round; errors here are reported to the server.

    SIGTERM is reported as a lost connection, not as an error, so that the robot may reconnect.
    """
    try:
        _converse(line, handler, count, n_parameters)
    except (ServerLost, SystemExit, KeyboardInterrupt):
        raise
    except BaseException as error:
        line.stream.finish(encode(Failure(described(error))), linger_s=1.0)
        raise


def _converse(line: _Line, handler: Robots, count: int, n_parameters: int) -> None:
    """Serve steps until the end of the round."""
    uploaded = -1
    while True:
        message = line.recv()
        if isinstance(message, Step):
            rows, due = len(message.updates), count * line.layout.worlds
            if rows != due:
                raise FrameError(f"a step of {rows} records, not {due}")
            given = answer(handler, message, count, n_parameters, line.layout)
            if given is None:
                return
            if message.expect is Expect.ACTIONS:
                uploaded = -1
                line.send(encode(Actions(message.tick, given)))
            else:
                uploaded = message.window
                line.send(encode(Weights(message.window, given)))
        elif isinstance(message, Weights) and message.window == uploaded:
            fits = _fitting(checked_download, message.weights, count, n_parameters, line.layout)
            handler.download(message.window, fits)
            uploaded = -1
        elif isinstance(message, Abort):
            uploaded = -1
            line.send(encode(Ack(message.number, tuple(handler.windows()))))
        elif isinstance(message, Restore):
            model = message.model
            if model is not None:
                model = _fitting(checked_model, model, count, n_parameters)
            handler.begin(message.window, model)
            uploaded = -1
            line.send(encode(Ack(message.number)))
        elif isinstance(message, Failure):
            raise ServerLost(f"the server has stopped: {message.reason}")
        else:
            raise FrameError(f"{type(message).__name__} out of turn")


def _fitting(check: Callable[..., Any], *given: object) -> Any:
    """What the server sends, if it is as was agreed."""
    try:
        return check(*given)
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
