"""The lockstep link between two hosts: one end a process, both with toy robots.

``python link_ends.py server HOST TICKS TIMEOUT_S`` says its port, then when it is under way, then
what came of it, each as a line of JSON; ``python link_ends.py client HOST PORT TIMEOUT_S`` first
measures the cable with bare datagrams, then serves, then says what came of it.
"""

from __future__ import annotations

import json
import socket
import statistics
import sys
import threading
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "lockstep"))
from link_helpers import PARAMETERS, SHAPE, Recorder, drive, token

from lockstep.client import serve
from lockstep.errors import LinkError
from lockstep.local import InProcessFleet
from lockstep.server import LinkServer

ROBOTS = 3
EVERY = 50
"""Ticks between uploads."""
UNDER_WAY = 20
"""The tick at which the server says that it is under way."""
JOIN_S = 30.0
DATAGRAMS = 100
DATAGRAM_SIZE = 100  # about a step of three robots


class TimedLink:
    """A fleet that remembers the longest wait for actions."""

    def __init__(self, fleet: LinkServer) -> None:
        self._fleet = fleet
        self.longest_s = 0.0

    def __getattr__(self, name: str) -> object:
        return getattr(self._fleet, name)

    def actions(self, tick: int) -> np.ndarray:
        """See ``Fleet.actions``."""
        began = time.perf_counter()
        given = self._fleet.actions(tick)
        self.longest_s = max(self.longest_s, time.perf_counter() - began)
        if tick == UNDER_WAY:
            say(under_way=True)
        return given


def run_server(host: str, ticks: int, timeout_s: float) -> None:
    """Drives the robots, and compares what they say with the same robots in this process."""
    block = tuple(range(ROBOTS))
    server = LinkServer(host, fingerprint="v1", timeout_s=timeout_s)
    fleet = TimedLink(server)
    server.admit([block], {robot: token(robot) for robot in block}, SHAPE)
    threading.Thread(target=echo, args=server.address, daemon=True).start()
    say(port=server.address[1])
    try:
        server.wait_connected(JOIN_S)
        began = time.perf_counter()
        seen = drive(fleet, ROBOTS, ticks, EVERY)
        elapsed_s = time.perf_counter() - began
    except LinkError as error:
        say(error=type(error).__name__, message=str(error))
        return
    finally:
        server.close()
    due = drive(InProcessFleet([(block, Recorder(block))]), ROBOTS, ticks, EVERY)
    correct = len(seen) == len(due) and all(map(np.array_equal, seen, due))
    say(correct=correct, round_trips=len(due), elapsed_s=elapsed_s, longest_s=fleet.longest_s)


def run_client(host: str, port: int, timeout_s: float) -> None:
    """Serves the robots, and says how it ended."""
    bare_ms = round_trip_ms(host, port)
    block = list(range(ROBOTS))
    tokens = [token(robot) for robot in block]
    options = {"fingerprint": "v1", "timeout_s": JOIN_S, "n_parameters": PARAMETERS}
    try:
        serve((host, port), block, tokens, Recorder(block), idle_timeout_s=timeout_s, **options)
    except LinkError as error:
        say(error=type(error).__name__, message=str(error), bare_ms=bare_ms)
    else:
        say(error="", message="", bare_ms=bare_ms)


def echo(host: str, port: int) -> None:
    """Sends every datagram back."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind((host, port))
        while True:
            sock.sendto(*sock.recvfrom(DATAGRAM_SIZE))


def round_trip_ms(host: str, port: int) -> float:
    """The median round trip of bare datagrams, in ms."""
    took_ms = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.settimeout(0.5)
        for number in range(DATAGRAMS):
            sent = number.to_bytes(DATAGRAM_SIZE, "big")
            began = time.perf_counter()
            sock.sendto(sent, (host, port))
            try:
                while sock.recv(DATAGRAM_SIZE) != sent:
                    pass
            except TimeoutError:
                continue  # lost
            took_ms.append(1e3 * (time.perf_counter() - began))
    return statistics.median(took_ms)


def say(**values: object) -> None:
    """A line of JSON."""
    print(json.dumps(values), flush=True)


if __name__ == "__main__":
    end, host, number, timeout = sys.argv[1:]
    (run_server if end == "server" else run_client)(host, int(number), float(timeout))
