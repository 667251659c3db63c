"""What Flower's processes are given: variables, a private home, free ports, their commands."""

from __future__ import annotations

import os
import shutil
import socket
import sysconfig
from pathlib import Path

from experiments.flower.processes import MARKER

HOST = "127.0.0.1"
CONNECTION = "risfleet"

_SETTINGS = {
    "FLWR_TELEMETRY_ENABLED": "0",
    "FLWR_DISABLE_UPDATE_CHECK": "1",
    # Without it a SuperLink installs the dependencies anew for every run, torch included.
    "FLWR_DISABLE_RUNTIME_DEPENDENCY_INSTALLATION": "1",
    "RAY_USAGE_STATS_ENABLED": "0",
    # Ray hides accelerators from workers that ask for none: let every runtime see the same.
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}
_FOREIGN = ("RAY_ADDRESS", "RAY_NAMESPACE", "FLWR_DATABASE")  # would lead to another's cluster


class FlowerError(RuntimeError):
    """Flower could not be started or did not do its work."""

    def __init__(self, message: str, log: str = "") -> None:
        """Make the error's text.

        Args:
            message: one sentence for the user.
            log: the relevant end of a log, shown below the sentence.
        """
        super().__init__(f"{message}\n{log.rstrip()}" if log.strip() else message)


class ProcessLostError(FlowerError):
    """A process of Flower's ended without a word: killed, or out of memory."""


def child_environment(home: Path, marker: str) -> dict[str, str]:
    """Environment of a session's processes: ours, with Flower and Ray turned to the private home.

    Args:
        home: the session's private folder.
        marker: the session's name, by which its processes are found again.

    Returns:
        The variables.
    """
    environment = {key: value for key, value in os.environ.items() if key not in _FOREIGN}
    environment |= _SETTINGS | {MARKER: marker, "FLWR_HOME": str(home), "RAY_TMPDIR": str(home)}
    scripts = sysconfig.get_path("scripts")  # Flower starts its own commands by their bare names
    environment["PATH"] = os.pathsep.join([scripts, environment.get("PATH", os.defpath)])
    for key in ("no_proxy", "NO_PROXY"):
        environment[key] = ",".join(filter(None, [environment.get(key), HOST, "localhost"]))
    return environment


def flower_command(name: str) -> str:
    """Path of a command that Flower's distribution installs.

    Args:
        name: `flwr` or `flower-superlink`, for example.

    Returns:
        The path.

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
