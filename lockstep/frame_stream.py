"""Whole frames over one socket, through one preallocated buffer."""

import contextlib
import socket
import ssl
import struct
import time

import numpy as np

from lockstep.wire_format import HEADER, frame_size

SILENCE_S = 20
"""How long a connection may carry nothing back before the kernel gives it up, in s."""

_NOT_NOW = (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError)


def prepare(sock: socket.socket) -> None:
    """Sets a TCP socket to send at once, and to notice a peer that has gone without a word.

    A cable that is cut says nothing. Probes find out while nothing is under way, and a limit on
    what is sent but not acknowledged does so else; either ends the connection with an error.
    """
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (
        ("TCP_KEEPIDLE", SILENCE_S // 4),
        ("TCP_KEEPINTVL", SILENCE_S // 4),
        ("TCP_KEEPCNT", 3),
        ("TCP_USER_TIMEOUT", SILENCE_S * 1000),
    ):
        if hasattr(socket, name):  # Linux; elsewhere the link's own deadlines hold
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


class FrameStream:
    """Sends and receives frames; whether it waits is up to the socket's timeout."""

    def __init__(self, sock: socket.socket, limit: int) -> None:
        """Take over a connected socket, plain or TLS, non-blocking or with a timeout.

        A frame may have `limit` bytes.
        """
        self._sock, self._limit = sock, limit
        self._view = np.empty(limit, np.uint8).data
        self._have = self._used = 0

    def fileno(self) -> int:
        """The socket's descriptor, -1 once closed."""
        return self._sock.fileno()

    @property
    def surplus(self) -> int:
        """Bytes that came in behind the frame that was received last."""
        return self._have - self._used

    def receive(self) -> memoryview | None:
        """The next whole frame, valid until the next call; None if it is not there yet.

        Raises:
            FrameError: what comes in is no frame, or one too long.
            EOFError: the peer has closed the connection.
            OSError: the connection is broken, or the socket's timeout has passed.
        """
        have, view = self._have, self._view
        if self._used:
            rest = have - self._used
            if rest:
                view[:rest] = view[self._used : have]
            self._have = have = rest
            self._used = 0
        while True:
            if have >= HEADER.size:
                size = frame_size(view, self._limit)
                if have >= size:
                    self._used = size
                    return view[:size]
            try:
                got = self._sock.recv_into(view[have:])
            except _NOT_NOW:
                return None
            if not got:
                raise EOFError("the connection was closed by the other side")
            self._have = have = have + got

    def send(self, frame: bytes, timeout_s: float) -> None:
        """Send a whole frame.

        Raises:
            OSError: the connection is broken, or the peer did not take it in time.
        """
        try:
            sent = self._sock.send(frame)
        except _NOT_NOW:
            sent = 0
        if sent < len(frame):
            before = self._sock.gettimeout()
            self._sock.settimeout(timeout_s)
            try:
                self._sock.sendall(memoryview(frame)[sent:])
            finally:
                self._sock.settimeout(before)

    def set_timeout(self, timeout_s: float) -> None:
        """Wait this long at most from now on, in `receive` and `send`."""
        if isinstance(self._sock, ssl.SSLSocket):
            self._sock.settimeout(timeout_s)
            return
        # The kernel keeps the deadline: a socket with a timeout would be polled before each call.
        limit = struct.pack("ll", int(timeout_s), min(999_999, int(timeout_s % 1 * 1e6) + 1))
        self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, limit)
        self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)
        self._sock.settimeout(None)

    def finish(self, frame: bytes, linger_s: float) -> None:
        """Send a last frame, if the peer still takes it, and close.

        Waits `linger_s` at most for the peer to close first: a connection that is closed with
        unread data is reset, and could take the last frame with it.
        """
        with contextlib.suppress(OSError, EOFError):
            self.send(frame, linger_s or 0.05)
            if linger_s and not isinstance(self._sock, ssl.SSLSocket):
                self._sock.shutdown(socket.SHUT_WR)
                deadline = time.monotonic() + linger_s
                while (rest := deadline - time.monotonic()) > 0:
                    self._sock.settimeout(rest)
                    if not self._sock.recv(65536):
                        break
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._sock.close()
