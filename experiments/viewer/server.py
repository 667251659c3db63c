"""The page of a run on this machine's loopback: one page, its events, and rooms on request."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote

from experiments.viewer.follower import UNREADABLE, Follower
from experiments.viewer.page import page

HOST = "127.0.0.1"
PERIOD_S = 0.5
BEAT_S = 15.0
"""After so long without news a comment is sent, so that a page that has gone is noticed."""

POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline';"
    " connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none';"
    " frame-ancestors 'none'"
)


class WatchServer(ThreadingHTTPServer):
    """Serves the page of one run to this machine alone; it changes nothing.

    Args:
        follower: of the run.
        port: to listen on; 0 picks a free one.

    Raises:
        OSError: the port is taken.
    """

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, follower: Follower, port: int = 0) -> None:
        self.follower = follower
        self.stopping = threading.Event()
        self._reading = threading.Lock()
        super().__init__((HOST, port), _Handler)

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self.server_address[1]}/"

    def events(self) -> list[tuple[str, str]]:
        """What the page is to show now; pages take turns."""
        with self._reading:
            return [*self.follower.events()]

    def room(self, name: str) -> str | None:
        """A room's panel as JSON."""
        with self._reading:
            try:
                panel = self.follower.panel(name)
            except UNREADABLE:
                return None
        return None if panel is None else json.dumps(panel)

    def server_close(self) -> None:
        """Ends the streams of events, and stops listening."""
        self.stopping.set()
        super().server_close()


class _Handler(BaseHTTPRequestHandler):
    server: WatchServer
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "risfleet", ""
    timeout = 60

    def do_GET(self) -> None:
        """Answers a request; whoever asks for another host's page is refused."""
        port = self.server.server_address[1]
        if self.headers.get("Host") not in {f"{name}:{port}" for name in (HOST, "localhost")}:
            self.send_error(HTTPStatus.FORBIDDEN, "this page is for this machine alone")
        elif self.path == "/":
            self._page()
        elif self.path == "/events":
            self._stream()
        elif self.path.startswith("/room/"):
            self._room(unquote(self.path.removeprefix("/room/")))
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def log_message(self, format: str, *args: object) -> None:
        """Says nothing of each request."""

    def _page(self) -> None:
        follower = self.server.follower
        title = f"RISFleet: {follower.folder}"
        self._answer("text/html; charset=utf-8", page(title, {"panels": [], "follows": True}))

    def _room(self, name: str) -> None:
        panel = self.server.room(name)
        if panel is None:
            self.send_error(HTTPStatus.NOT_FOUND, "no episode of that room yet")
        else:
            self._answer("application/json", panel)

    def _answer(self, kind: str, text: str) -> None:
        content = text.encode()
        self._head(kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def _head(self, kind: str) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", POLICY)
        self.send_header("X-Content-Type-Options", "nosniff")

    def _stream(self) -> None:
        """Sends events as they come, until the page goes or the server stops."""
        self.close_connection = True
        self._head("text/event-stream")
        self.end_headers()
        try:
            for text in self._news():
                self.wfile.write(text.encode())
                self.wfile.flush()
        except OSError:
            return  # the page has gone

    def _news(self) -> Iterator[str]:
        sent: dict[str, str] = {}
        last = time.monotonic()
        while not self.server.stopping.is_set():
            for name, data in self.server.events():
                if sent.get(name) != data:
                    sent[name], last = data, time.monotonic()
                    yield f"event: {name}\ndata: {data}\n\n"
            if time.monotonic() - last > BEAT_S:
                last = time.monotonic()
                yield ": still here\n\n"
            self.server.stopping.wait(PERIOD_S)
