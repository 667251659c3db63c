"""Two hosts on this machine: network namespaces with a cable that can be long, bad, or cut."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, Literal

ADDRESSES = ("10.77.0.1", "10.77.0.2")
DEVICE = "cable"

Side = Literal[0, 1]


def obstacle() -> str:
    """Why this machine lets us make no hosts, empty if it does."""
    if sys.platform != "linux":
        return "network namespaces need Linux"
    if os.geteuid() != 0:
        return "network namespaces need root"
    if shutil.which("ip") is None:
        return "network namespaces need the command ip (Debian: apt-get install iproute2)"
    name = f"rf-{uuid.uuid4().hex[:8]}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True)
    if made.returncode != 0:
        return f"network namespaces are not permitted here: {made.stderr.strip()}"
    has_netem = _has_netem(name)
    _ip("netns", "del", name)
    if not has_netem and not Path("/dev/net/tun").exists():
        return "neither netem nor /dev/net/tun is there to make a cable of"
    return ""


class TwoHosts:
    """Two network namespaces joined by a cable; all is removed on exit.

    The cable is a veth pair with ``tc netem``, or a process between two TAP devices (see
    `tools.chaos.network_link`) where the kernel has no netem.

    Args:
        delay_ms: one way.
        loss_percent: of the packets, each way.
        seed: of the losses; netem has its own.

    Attributes:
        names: of the namespaces.
        kind: `netem` or `relay`.
    """

    def __init__(self, delay_ms: float = 0.0, loss_percent: float = 0.0, seed: int = 0) -> None:
        key = uuid.uuid4().hex[:8]
        self.names = (f"rf-{key}-0", f"rf-{key}-1")
        self.kind = ""
        self._ends = (f"rf{key}0", f"rf{key}1")
        self._delay_ms, self._loss_percent, self._seed = delay_ms, loss_percent, seed
        self._made: list[str] = []
        self._children: list[subprocess.Popen[str]] = []

    def __enter__(self) -> TwoHosts:
        """Makes the namespaces and the cable."""
        try:
            for name in self.names:
                _ip("netns", "add", name)
                self._made.append(name)
            self.kind = "netem" if _has_netem(self.names[0]) else "relay"
            if self.kind == "netem":
                _ip("link", "add", self._ends[0], "type", "veth", "peer", "name", self._ends[1])
            else:
                self._start_relay()
            for side in (0, 1):
                self._plug_in(side)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        """Removes everything."""
        self.close()

    def start(
        self,
        side: Side,
        argv: Sequence[str],
        output: IO[str] | int = subprocess.PIPE,
        **options: Any,
    ) -> subprocess.Popen[str]:
        """Starts a command on a host; it is killed on exit if it is still there.

        Args:
            side: which host.
            argv: the command; the process that is returned becomes it.
            output: where its standard output goes; its standard error is ours.
            options: further ones of `Popen`.
        """
        command = ["ip", "netns", "exec", self.names[side], *argv]
        given = {"stdin": subprocess.DEVNULL, "stdout": output, "text": True} | options
        child = subprocess.Popen(command, **given)
        self._children.append(child)
        return child

    def cut(self) -> None:
        """Cuts the cable, at the end of host 0."""
        _ip("-n", self.names[0], "link", "set", DEVICE, "down")

    def mend(self) -> None:
        """Joins the cable again."""
        _ip("-n", self.names[0], "link", "set", DEVICE, "up")

    def close(self) -> None:
        """Ends the processes that were started, and removes hosts and cable."""
        for child in self._children:
            if child.poll() is None:
                child.kill()
            child.wait()
            if child.stdout is not None:
                child.stdout.close()
        while self._made:
            _ip("netns", "del", self._made.pop())

    def _start_relay(self) -> None:
        numbers = [str(self._delay_ms), str(self._loss_percent), str(self._seed)]
        program = str(Path(__file__).with_name("network_link.py"))
        relay = subprocess.Popen(
            [sys.executable, program, *self._ends, *numbers], stdout=subprocess.PIPE, text=True
        )
        self._children.append(relay)
        if relay.stdout is None or relay.stdout.readline() != "ready\n":
            raise OSError("the cable's process did not start")

    def _plug_in(self, side: Side) -> None:
        name, end = self.names[side], self._ends[side]
        _ip("link", "set", end, "netns", name)
        inside = ("-n", name)
        _ip(*inside, "link", "set", end, "name", DEVICE)
        _ip(*inside, "address", "add", f"{ADDRESSES[side]}/24", "dev", DEVICE)
        _ip(*inside, "link", "set", "lo", "up")
        _ip(*inside, "link", "set", DEVICE, "up")
        if self.kind == "netem":
            shape = ("delay", f"{self._delay_ms}ms", "loss", f"{self._loss_percent}%")
            call("tc", *inside, "qdisc", "add", "dev", DEVICE, "root", "netem", *shape)


def _has_netem(namespace: str) -> bool:
    """Whether the kernel knows netem; a namespace's loopback is left as it was."""
    change = ("dev", "lo", "root", "netem", "delay", "1ms")
    if shutil.which("tc") is None:
        return False
    made = subprocess.run(["tc", "-n", namespace, "qdisc", "add", *change], capture_output=True)
    if made.returncode == 0:
        call("tc", "-n", namespace, "qdisc", "del", "dev", "lo", "root")
    return made.returncode == 0


def _ip(*arguments: str) -> None:
    call("ip", *arguments)


def call(*command: str) -> None:
    """Runs a command.

    Raises:
        OSError: it failed, and what it said.
    """
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise OSError(f"`{' '.join(command)}` failed: {done.stderr.strip()}")
