"""The acceptor: takes pending connections' hellos on a thread of its own, beside the run.

A pending connection has a few seconds and a small buffer for its hello. Only a valid hello leads
any further; everything else ends with a closed connection and a line in the log.
"""

import contextlib
import hmac
import logging
import selectors
import socket
import ssl
import threading
import time
from collections import deque
from dataclasses import dataclass, field

from lockstep.errors import FrameError, described, named
from lockstep.frame_stream import FrameStream, prepare
from lockstep.frames import decode, encode
from lockstep.messages import VERSION, Hello, Rejection, Welcome
from lockstep.wire_format import HELLO_SIZE

log = logging.getLogger(__name__)
MAX_PENDING = 64


@dataclass(frozen=True, eq=False)
class RoundCredentials:
    """Who is let in: the terms of one round."""

    fingerprint: str
    blocks: tuple[tuple[int, ...], ...]
    tokens: dict[int, str] = field(repr=False)

    def refusal(self, hello: Hello) -> str | None:
        """Why a hello is not good enough; None if it is."""
        if hello.version != VERSION:
            return f"the client speaks link version {hello.version}, the server {VERSION}"
        if hello.fingerprint != self.fingerprint:
            return (
                f"the client runs '{hello.fingerprint}', the server '{self.fingerprint}': "
                "install the same version on both"
            )
        if tuple(hello.robots) not in self.blocks or len(hello.tokens) != len(hello.robots):
            return f"no client is expected with {named(hello.robots)}"
        valid = True
        for robot, token in zip(hello.robots, hello.tokens, strict=True):
            valid &= hmac.compare_digest(token.encode(), self.tokens[robot].encode())
        return None if valid else f"a token of {named(hello.robots)} is not valid in this round"


@dataclass(frozen=True, eq=False)
class AcceptedClient:
    """A client that was let in."""

    admission: RoundCredentials
    block: tuple[int, ...]
    sock: socket.socket


class PendingConnection:
    """A connection that has until `deadline` (monotonic, s) to say a valid hello."""

    def __init__(self, sock: socket.socket, peer: str, deadline: float) -> None:
        self.sock, self.peer, self.deadline = sock, peer, deadline
        self.stream = FrameStream(sock, HELLO_SIZE)
        self._handshake = sock.do_handshake if isinstance(sock, ssl.SSLSocket) else None

    def recv(self) -> Hello | None:
        """The hello, None as long as it is not complete."""
        if self._handshake is not None:
            try:
                self._handshake()
            except (ssl.SSLWantReadError, ssl.SSLWantWriteError):
                return None
            self._handshake = None
        frame = self.stream.receive()
        if frame is None:
            return None
        message = decode(frame)
        if not isinstance(message, Hello) or self.stream.surplus:
            raise FrameError("the first frame must be a hello, and nothing may follow it")
        return message


class Acceptor(threading.Thread):
    """Listens, hears hellos, and hands those who may come in to the run."""

    def __init__(
        self, listener: socket.socket, handshake_s: float, context: ssl.SSLContext | None
    ) -> None:
        """An acceptor that is not yet listening; `start` begins."""
        super().__init__(name="link-acceptor", daemon=True)
        self.admission: RoundCredentials | None = None
        self.accepted: deque[AcceptedClient] = deque()
        self.wakeup, self._wakeup_sender = socket.socketpair()
        self._listener, self._handshake_s, self._context = listener, handshake_s, context
        self._halt, self._halter = socket.socketpair()
        self._pending: dict[int, PendingConnection] = {}
        self._selector = selectors.DefaultSelector()
        for sock in (listener, self.wakeup, self._wakeup_sender, self._halt):
            sock.setblocking(False)

    def run(self) -> None:
        """Until `shut`, serve whoever comes; no pending connection can end or block this."""
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._halt, selectors.EVENT_READ)
        while True:
            first = min((each.deadline for each in self._pending.values()), default=None)
            wait = None if first is None else max(0.0, first - time.monotonic())
            for key, _ in self._selector.select(wait):
                if key.fileobj is self._halt:
                    return
                if key.fileobj is self._listener:
                    self._open()
                elif key.fd in self._pending:
                    self._hear(self._pending[key.fd])
            now = time.monotonic()
            for late in [each for each in self._pending.values() if each.deadline <= now]:
                self._turn_away(late, "said no hello in time")

    def shut(self) -> None:
        """Stop, and close all that has not been handed over."""
        if self.is_alive():
            self._halter.send(b"x")
            self.join()
        for pending in self._pending.values():
            pending.stream.close()
        while self.accepted:
            self.accepted.popleft().sock.close()
        self._selector.close()
        for sock in (self._listener, self.wakeup, self._wakeup_sender, self._halt, self._halter):
            sock.close()

    def _open(self) -> None:
        """Accept one pending connection."""
        try:
            sock, address = self._listener.accept()
        except OSError as error:
            if not isinstance(error, BlockingIOError | ConnectionError):
                log.warning("no connection can be accepted: %s", described(error))
                time.sleep(0.1)
            return
        try:
            sock.setblocking(False)
            prepare(sock)
            if self._context is not None:
                sock = self._context.wrap_socket(
                    sock, server_side=True, do_handshake_on_connect=False
                )
            deadline = time.monotonic() + self._handshake_s
            newcomer = PendingConnection(sock, f"{address[0]}:{address[1]}", deadline)
            self._selector.register(sock, selectors.EVENT_READ)
        except (OSError, ValueError) as error:
            log.warning("a connection was closed: %s", described(error))
            sock.close()
            return
        self._pending[sock.fileno()] = newcomer
        if len(self._pending) > MAX_PENDING:
            self._turn_away(next(iter(self._pending.values())), "made room for others")

    def _hear(self, pending: PendingConnection) -> None:
        """Let a pending connection speak; nothing that it says may do harm."""
        try:
            hello = pending.recv()
            if hello is not None:
                self._judge(pending, hello)
        except Exception as error:
            self._turn_away(pending, described(error))

    def _judge(self, pending: PendingConnection, hello: Hello) -> None:
        """Hand a pending connection over to the run, or refuse it with the reason."""
        admission = self.admission
        reason = "no round is open" if admission is None else admission.refusal(hello)
        if admission is None or reason is not None:
            pending.stream.send(encode(Rejection(str(reason))), 0.0)
            self._turn_away(pending, f"refused: {reason}")
            return
        pending.stream.send(encode(Welcome()), 0.0)
        self._forget(pending)
        self.accepted.append(AcceptedClient(admission, tuple(hello.robots), pending.sock))
        with contextlib.suppress(BlockingIOError):
            self._wakeup_sender.send(b"x")

    def _turn_away(self, pending: PendingConnection, reason: str) -> None:
        log.warning("connection from %s closed: %s", pending.peer, reason)
        self._forget(pending)
        pending.stream.close()

    def _forget(self, pending: PendingConnection) -> None:
        """Listen to a pending connection no more."""
        self._selector.unregister(pending.sock)
        del self._pending[pending.sock.fileno()]
