"""Lockstep between two hosts with a long cable: steps per second against one a round trip.

The server with world, access point and coordinator is on one host, three robots, each in a process
of its own, on the other; hosts are network namespaces of this machine, which needs root.

``python -m benchmarks.distance server HOST STEPS BLOCKS`` and
``python -m benchmarks.distance client HOST PORT ROBOT`` are the two ends.
"""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import numpy as np

from agent import single_threaded
from benchmarks.clients import PATIENCE_S, Mode, client, opened, token
from benchmarks.deployment import Server, Times
from benchmarks.local import configured
from benchmarks.result import Result, Skipped
from tools.chaos.hosts import ADDRESSES, TwoHosts, obstacle

DELAYS_MS = (1, 5, 20)
ROBOTS = 3
HOW = (
    "joint steps per second with {} ms of delay one way, over one a round trip of {} ms: 3 robots,"
    " a process each, on one host, the server on another, weights every N_F ticks included"
)


def distance(*, quick: bool = False) -> list[Result]:
    """Measures ``distance_*ms_vs_bound``.

    Raises:
        Skipped: this machine lets us make no hosts.
    """
    if reason := obstacle():
        raise Skipped(reason)
    return [_over(delay_ms, quick=quick) for delay_ms in (DELAYS_MS[:1] if quick else DELAYS_MS)]


def _over(delay_ms: int, *, quick: bool) -> Result:
    """Steps per second over a cable of this delay, one way."""
    steps, blocks = (50, 1) if quick else (100, 5)
    with TwoHosts(delay_ms) as hosts:
        python = [sys.executable, "-m", "benchmarks.distance"]
        server = hosts.start(0, [*python, "server", ADDRESSES[0], str(steps), str(blocks)])
        port = str(_line(server)["port"])
        for robot in range(ROBOTS):
            hosts.start(1, [*python, "client", ADDRESSES[0], port, str(robot)])
        wall = {mode: np.array(seconds) for mode, seconds in _line(server).items()}
        kind = hosts.kind
    bound = 1e3 / (2 * delay_ms)
    rate = steps / wall["LOCKSTEP"]
    details = {
        "bound_per_s": bound,
        "steps_per_s": float(np.median(rate)),
        "nothing_done_steps_per_s": float(np.median(steps / wall["LINK"])),
        f"cable_{kind}": 1.0,
    }
    how = HOW.format(delay_ms, 2 * delay_ms)
    return Result.over(f"distance_{delay_ms}ms_vs_bound", rate / bound, "ratio", how, None, details)


def serve_blocks(host: str, steps: int, blocks: int) -> None:
    """Plays blocks in lockstep and blocks of the same messages with nothing done, in turn."""
    config = configured(f"env.robots={ROBOTS}")
    link = opened(config, host)
    _say(port=link.address[1])
    try:
        link.wait_connected(PATIENCE_S)
        server, times = Server(config, link, steps), Times()
        for _ in range(2):
            server.block(Mode.LOCKSTEP, Times())  # fills the replays
        for _ in range(blocks):
            for mode in (Mode.LOCKSTEP, Mode.LINK):
                server.block(mode, times)
        server.farewell()
    finally:
        link.close("the benchmark has ended")
    _say(**{mode.name: seconds for mode, seconds in times.wall.items() if seconds})


def _say(**values: object) -> None:
    print(json.dumps(values), flush=True)


def _line(child: subprocess.Popen[str]) -> dict[str, Any]:
    """The next line that an end says.

    Raises:
        RuntimeError: it has ended without one.
    """
    assert child.stdout is not None
    line = child.stdout.readline()
    if not line:
        raise RuntimeError("the server's process ended without a word")
    said: dict[str, Any] = json.loads(line)
    return said


if __name__ == "__main__":
    single_threaded()
    end, host, *numbers = sys.argv[1:]
    if end == "server":
        serve_blocks(host, *map(int, numbers))
    else:
        port, robot = map(int, numbers)
        client(configured(f"env.robots={ROBOTS}"), robot, (host, port), token(robot))
