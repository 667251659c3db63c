"""A real deployment on two hosts, made by the commands of ``docs/deployment.md``.

Host 0 has the SuperLink, with TLS and with SuperNode authentication, and the command that trains;
host 1 has the SuperNodes, each with its own keys and its own folder of states. SuperNodes are
started again as systemd starts them by the unit of ``docs/systemd``.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
import uuid
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from experiments.flower.environment import flower_command
from experiments.flower.variables import chosen
from repeatable.process_tracker import MARK, ProcessTracker
from repeatable.processes import command
from tools.chaos.attempt import ROOT
from tools.chaos.hosts import ADDRESSES, Side, TwoHosts

HUB: Side = 0
FAR: Side = 1
NODES = 2
SUPERLINK = f"{ADDRESSES[HUB]}:8000"
LINK_PORT = 8001
CONNECTION = "risfleet"

START_WITHIN_S = 90.0
GONE_WITHIN_S = 30.0
RESTART_S = 5.0
"""`RestartSec` of the unit."""

_FIRST_PORT = 9094
"""Of the SuperNodes' Runtime APIs, which share the loopback of their host."""


class FleetError(RuntimeError):
    """The fleet did not come up, and why."""


@dataclass
class Node:
    """A SuperNode.

    Attributes:
        folder: of all that is its own.
        process: the one that was started last.
        starts: how often it was started.
        ended: when it was first seen to have ended, monotonic, in s; None while it is there.
    """

    folder: Path
    process: subprocess.Popen[str]
    starts: int = 1
    ended: float | None = None


class ChaosFleet:
    """Starts the fleet on entry; on exit none of its processes is left.

    Args:
        hosts: where.
        scratch: a folder for all files of both hosts.

    Attributes:
        nodes: the SuperNodes.
        crowd: every process of the fleet.
    """

    def __init__(self, hosts: TwoHosts, scratch: Path) -> None:
        self._hosts = hosts
        self._hub, self._scratch = scratch / "hub", scratch
        self._mark = uuid.uuid4().hex
        self._superlink: subprocess.Popen[str] | None = None
        self.nodes: list[Node] = []
        self.crowd = ProcessTracker(0, self._mark)

    def __enter__(self) -> ChaosFleet:
        """Makes the keys, and starts SuperLink and SuperNodes.

        Raises:
            FleetError: one of the commands failed.
        """
        (self._hub / "flower").mkdir(parents=True)
        try:
            self._make_keys()
            self._start_superlink()
            for number in range(NODES):
                self._register(number)
                folder = self._own(number)
                self.nodes.append(Node(folder, self._start_node(folder)))
        except BaseException:
            self.crowd.end()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        """Ends whatever is left."""
        self.crowd.end()

    @property
    def states(self) -> list[Path]:
        """The SuperNodes' folders of their robots' states."""
        return [node.folder / "state" for node in self.nodes]

    def train(self, given: Sequence[str]) -> subprocess.Popen[str]:
        """Starts the command that trains, on the SuperLink's host.

        Args:
            given: its arguments behind `train`, without those that name the fleet.
        """
        where = [f"federation.link.host={ADDRESSES[HUB]}", f"federation.link.port={LINK_PORT}"]
        argv = _risfleet("train", *given, f"runtime.connection={CONNECTION}", *where)
        return self._start(HUB, argv, self._hub, "train")

    def said(self, place: str) -> str:
        """What a process has printed: ``hub/train``, ``hub/superlink``, ``node-0/supernode``."""
        return (self._scratch / f"{place}.log").read_text(errors="replace")

    def tend(self) -> None:
        """Starts SuperNodes again that ended some seconds ago."""
        for node in self.nodes:
            if node.process.poll() is None:
                node.ended = None
            elif node.ended is None:
                node.ended = time.monotonic()
            elif time.monotonic() - node.ended > RESTART_S:
                node.process, node.ended = self._start_node(node.folder), None
                node.starts += 1

    def stop(self) -> list[str]:
        """Asks SuperNodes and SuperLink to end, as systemd does.

        Returns:
            Command lines of processes that are there in spite of it.
        """
        for process in [*(node.process for node in self.nodes), self._superlink]:
            if process is not None and process.poll() is None:
                process.terminate()
                with suppress(subprocess.TimeoutExpired):  # then it is among those that are left
                    process.wait(GONE_WITHIN_S)
        left, _ = self.crowd.wait_gone(GONE_WITHIN_S)
        return [f"{row.pid} {command(row)[:200]}" for row in left]

    def _make_keys(self) -> None:
        """Makes the keys, and gives every SuperNode its own."""
        self._run(_risfleet("keys", "keys", "--host", ADDRESSES[HUB], "--nodes", str(NODES)))
        for number in range(NODES):
            (self._own(number) / "flower").mkdir(parents=True)
            name = f"node-{number}"
            shutil.copytree(self._hub / "keys" / name, self._own(number) / "keys")
        (self._hub / "flower" / "config.toml").write_text(
            f'[superlink.{CONNECTION}]\naddress = "{SUPERLINK}"\n'
            f'root-certificates = "{self._hub / "keys" / "ca.crt"}"\n'
        )

    def _start_superlink(self) -> None:
        """Starts the SuperLink and waits until it listens."""
        host, port = SUPERLINK.split(":")
        argv = [
            flower_command("flower-superlink"), "--host", host, "--port", port,
            "--ssl-ca-certfile", "keys/ca.crt", "--ssl-certfile", "keys/superlink.crt",
            "--ssl-keyfile", "keys/superlink.key", "--enable-supernode-auth",
            "--disable-runtime-dependency-installation",
        ]  # fmt: skip
        self._superlink = self._start(HUB, argv, self._hub, "superlink")
        deadline = time.monotonic() + START_WITHIN_S
        while "Uvicorn running on https" not in (said := self.said("hub/superlink")):
            if self._superlink.poll() is not None or time.monotonic() > deadline:
                raise FleetError(f"The SuperLink did not start: {said[-800:]}")
            time.sleep(0.2)

    def _register(self, number: int) -> None:
        key = f"keys/node-{number}/node.pub"
        self._run([flower_command("flwr"), "supernode", "register", key, CONNECTION])

    def _start_node(self, folder: Path) -> subprocess.Popen[str]:
        number = int(folder.name.removeprefix("node-"))
        place = f'partition-id={number} num-partitions={NODES} state-dir="{folder / "state"}"'
        argv = [
            flower_command("flower-supernode"), "--superlink", SUPERLINK,
            "--root-certificates", "keys/ca.crt",
            "--auth-supernode-private-key", "keys/node.key",
            "--port", str(_FIRST_PORT + number), "--node-config", place,
        ]  # fmt: skip
        return self._start(FAR, argv, folder, "supernode")

    def _own(self, number: int) -> Path:
        return self._scratch / f"node-{number}"

    def _run(self, argv: Sequence[str]) -> None:
        """Runs a command on the hub to its end."""
        child = self._start(HUB, argv, self._hub, "setup")
        try:
            failed = child.wait(START_WITHIN_S) != 0
        except subprocess.TimeoutExpired:
            failed = True
        if failed:
            raise FleetError(f"`{' '.join(argv)}` failed: {self.said('hub/setup')[-800:]}")

    def _start(
        self, side: Side, argv: Sequence[str], folder: Path, name: str
    ) -> subprocess.Popen[str]:
        """Starts a command with its output in ``NAME.log`` of a folder."""
        scripts = str(Path(flower_command("flwr")).parent)
        paths = filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])
        environment = chosen() | {
            MARK: self._mark,
            "FLWR_HOME": str(folder / "flower"),
            "FLWR_TELEMETRY_ENABLED": "0",
            "FLWR_DISABLE_UPDATE_CHECK": "1",
            "PATH": os.pathsep.join([scripts, os.environ.get("PATH", os.defpath)]),
            "PYTHONPATH": os.pathsep.join(paths),
        }
        with (folder / f"{name}.log").open("a") as log:
            return self._hosts.start(
                side,
                argv,
                log,
                stderr=subprocess.STDOUT,
                cwd=folder,
                env=environment,
                start_new_session=True,
            )


def _risfleet(*arguments: str) -> list[str]:
    return [sys.executable, "-P", "-m", "experiments.cli", *arguments]
