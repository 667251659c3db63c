"""Robot clients as processes of their own, which a benchmark can put into three modes.

The mode travels in the window number of each step, so that one set of processes and one link
serve all three in turn:

* LOCKSTEP: a `RobotGroup` learns and acts, as in a deployment; its last block is recorded.
* LINK: a handler that does nothing answers, so that only the link works.
* FREE: one step starts the block; the group plays the recorded one again, waiting for nobody.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent import single_threaded
from benchmarks.local import initial_weights
from client_app.robots import RobotGroup
from conf import Config, from_yaml, robot_network, to_yaml
from lockstep import Expect, LinkServer, Step, serve
from lockstep.tls import client_context, server_context
from server_app.certificates import run_certificate

SPAN = 1 << 20
PATIENCE_S = 60.0
FINGERPRINT = "benchmark"


class Mode(IntEnum):
    """What a client does with a step."""

    LOCKSTEP = 0
    LINK = 1
    FREE = 2

    def window(self, window: int) -> int:
        """The window number that puts a client into this mode."""
        return self * SPAN + window


class Client:
    """One robot's handler; notes this process's processor time whenever the mode changes."""

    def __init__(self, group: RobotGroup, parameters: int) -> None:
        self._group = group
        self._idle = np.zeros(len(group.robots), np.int32)
        self._nothing = np.zeros((len(group.robots), 2, parameters), np.float32)
        self._mode: Mode | None = None
        self._recorded: list[Step] = []
        self.stamps: list[tuple[int, float]] = []

    def step(self, step: Step) -> NDArray[np.int32] | None:
        """Answers as the mode has it."""
        mode = Mode(step.window // SPAN)
        if mode is not self._mode or mode is Mode.FREE:
            self.stamps.append((int(mode), time.process_time()))
            if mode is Mode.LOCKSTEP:
                self._recorded = []
        self._mode = mode
        if mode is Mode.LOCKSTEP:
            self._recorded.append(step)
            return self._group.step(step)
        if mode is Mode.FREE:
            self._play_again()
        return self._idle

    def upload(self) -> NDArray[np.float32]:
        """The group's weights, or as many zeros."""
        return self._group.upload() if self._mode is Mode.LOCKSTEP else self._nothing

    def download(self, window: int, weights: NDArray[np.float32]) -> None:
        """Takes the global model in lockstep only."""
        if self._mode is Mode.LOCKSTEP:
            self._group.download(window, weights)

    def _play_again(self) -> None:
        for step in self._recorded:
            self._group.step(step)
            if step.expect is Expect.WEIGHTS:
                self._group.download(step.window, self._group.upload()[0])


def client(
    config: Config, robot: int, address: tuple[str, int], token: str, certificate: str = ""
) -> list[tuple[int, float]]:
    """Serves one robot.

    Args:
        config: of the run.
        robot: which.
        address: of the server.
        token: for this robot.
        certificate: of the server, PEM; empty without TLS.

    Returns:
        Its stamps.
    """
    single_threaded()
    group = RobotGroup(config, (robot,))
    group.download(0, initial_weights(config))
    handler = Client(group, group.parameters)
    serve(
        address,
        (robot,),
        (token,),
        handler,
        fingerprint=FINGERPRINT,
        timeout_s=PATIENCE_S,
        n_parameters=group.parameters,
        client_context=client_context(certificate) if certificate else None,
    )
    return [*handler.stamps, (-1, time.process_time())]


def reporting(report: Connection, text: str, *arguments: Any) -> None:
    """A client process: serves, then reports its stamps."""
    report.send(client(from_yaml(text), *arguments))
    report.close()


@dataclass(frozen=True)
class ClientProcesses:
    """The processes of all robots and the server's end of their link."""

    link: LinkServer
    reports: list[Connection]

    def stamps(self) -> list[list[tuple[int, float]]]:
        """What each process has noted, after the farewell: (mode, processor time) a block."""
        found = []
        for report in self.reports:
            if not report.poll(PATIENCE_S):
                raise TimeoutError("a client process did not report")
            found.append(report.recv())
        return found


def opened(
    config: Config, host: str = "127.0.0.1", tls: tuple[str, str] | None = None
) -> LinkServer:
    """The server's end of a link that awaits a client for each robot.

    Args:
        config: of the run.
        host: where it listens.
        tls: certificate and key, PEM.
    """
    context = server_context(*tls) if tls else None
    link = LinkServer(host, fingerprint=FINGERPRINT, timeout_s=PATIENCE_S, server_context=context)
    robots = range(config.env.robots)
    shape = (2, robot_network(config).parameters)
    link.admit([(robot,) for robot in robots], {robot: token(robot) for robot in robots}, shape)
    return link


def token(robot: int) -> str:
    """A robot's secret, which is none."""
    return f"robot-{robot}"


@contextmanager
def connected_clients(config: Config, *, secure: bool = False) -> Iterator[ClientProcesses]:
    """Starts a process for each robot, linked over loopback; all have ended on leaving."""
    tls = run_certificate("127.0.0.1") if secure else None
    link = opened(config, tls=tls)
    context = multiprocessing.get_context("spawn")
    started: list[BaseProcess] = []
    try:
        reports = []
        for robot in range(config.env.robots):
            receiving, sending = context.Pipe(duplex=False)
            whom = (robot, link.address, token(robot), tls[0] if tls else "")
            arguments = (sending, to_yaml(config), *whom)
            client = context.Process(target=reporting, args=arguments, daemon=True)
            client.start()
            sending.close()
            started.append(client)
            reports.append(receiving)
        link.wait_connected(PATIENCE_S, lambda: _check_alive(started))
        yield ClientProcesses(link, reports)
    finally:
        link.close("the benchmark has ended")
        for process in started:
            process.join(5.0)
            if process.is_alive():
                process.kill()
                process.join()


def _check_alive(processes: list[BaseProcess]) -> None:
    for process in processes:
        if process.exitcode is not None:
            raise RuntimeError(f"a client process ended at once, status {process.exitcode}")
