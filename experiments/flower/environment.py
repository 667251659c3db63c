"""What Flower's processes are given: variables, a private home, free ports, their commands."""

from __future__ import annotations

import os
import shutil
import socket
import sys
import sysconfig
from pathlib import Path

from experiments.flower import variables
from repeatable.processes import MARKER, SETTINGS, with_scripts

HOST = "127.0.0.1"
CONNECTION = "risfleet"

_SETTINGS = {
    **SETTINGS,
    # Ray hides accelerators from workers that ask for none: let every runtime see the same.
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}


class FlowerError(RuntimeError):
    """Flower could not be started or did not do its work."""

    def __init__(self, message: str, log: str = "") -> None:
        """Takes a sentence for the user, and the end of a log to show below it."""
        super().__init__(f"{message}\n{log.rstrip()}" if log.strip() else message)


class UnansweredError(FlowerError):
    """Flower was asked after a run and gave no answer, or no usable one; it may the next time."""


class ProcessLostError(FlowerError):
    """A process of Flower's ended without a word: killed, or out of memory."""


def child_environment(home: Path, marker: str) -> dict[str, str]:
    """Environment of a private session's processes: what is chosen of ours, and what they need.

    None of it leads through a proxy: the session does not leave this machine.

    Args:
        home: the session's private folder, to which Flower and Ray are turned.
        marker: the session's name, by which its processes are found again.
    """
    environment = with_scripts(variables.chosen()) | _SETTINGS
    if sys.platform == "darwin":  # where no variable says otherwise, the desktop's proxies count
        environment["no_proxy"] = "*"
    return environment | {"FLWR_HOME": str(home), "RAY_TMPDIR": str(home), MARKER: marker}


def user_environment(marker: str) -> dict[str, str]:
    """Environment of Flower's commands that talk to a federation of the user's.

    All of the user's variables are there, as if he typed the commands himself: his proxy,
    certificates and Flower's home count. Only what would colour their answers is left out, and
    what is on this machine is reached without a proxy.
    """
    environment = with_scripts({**os.environ}) | _SETTINGS | {MARKER: marker}
    for name in variables.COLOURS:
        environment.pop(name, None)
    for name in ("no_proxy", "NO_PROXY"):
        environment[name] = ",".join(filter(None, [environment.get(name), HOST, "localhost"]))
    return environment


def flower_command(name: str) -> str:
    """Path of a command that Flower's distribution installs, such as `flower-superlink`.

    Raises:
        FlowerError: it is not installed.
    """
    found = shutil.which(name, path=sysconfig.get_path("scripts")) or shutil.which(name)
    if found is None:
        raise FlowerError(f"The command {name} is missing: install 'flwr[simulation]'.")
    return found


def free_port() -> int:
    """A TCP port on loopback that is free now."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        port: int = probe.getsockname()[1]
    return port


def port_in_use(port: int) -> bool:
    """Whether something listens on that loopback port already."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError:
            return True
    return False


def tail(text: str, lines: int) -> str:
    """The last lines of a text."""
    return "\n".join(text.rstrip().splitlines()[-lines:])
