"""A stand-in for a SuperLink, and a way to wait."""

from __future__ import annotations

import time
from collections.abc import Callable

HEALTHY = """
    import http.server, sys
    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200); self.end_headers()
        def do_POST(self):
            self.send_error(404)
    http.server.HTTPServer(("127.0.0.1", int(sys.argv[-1])), Handler).serve_forever()
"""
"""The program of a SuperLink that answers and does nothing else."""


def wait_until(condition: Callable[[], bool]) -> None:
    """Waits as long as it takes on a busy machine."""
    deadline = time.monotonic() + 300
    while not condition():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.02)
