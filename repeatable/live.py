"""A run of an app on a private SuperLink of this machine, as a simulation or a deployment."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import tempfile
import time
import uuid
from pathlib import Path
from typing import Any

from repeatable.process_tracker import MARK, ProcessTracker
from repeatable.processes import SETTINGS, Process, started_apart, with_scripts

_HOST = "127.0.0.1"
_CONNECTION = "repeatable"
_COMMAND_S = 90.0
_SETTINGS = {
    **SETTINGS,
    "no_proxy": "*",
    # Sums depend on how many threads share them.
    **dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"),
}


class LiveError(RuntimeError):
    """Flower did not do what it was asked; the message has its words."""


class LiveRun:
    """Starts everything on entry; on exit no process and no file of it is left.

    Args:
        app: the folder of the app.
        clients: how many there are.
        config: values of the run's configuration, as ``flwr run --run-config`` takes them.
        deployment: whether clients are SuperNodes of their own.
    """

    def __init__(self, app: Path, clients: int, config: str, *, deployment: bool) -> None:
        self._app, self._clients, self._config = app.resolve(), clients, config
        self._deployment = deployment

    def __enter__(self) -> LiveRun:
        """Starts SuperLink and SuperNodes, and hands the app in.

        Raises:
            LiveError: Flower refuses.
        """
        short = "/tmp" if os.path.isdir("/tmp") else None  # Ray's sockets need short paths
        self._home = Path(tempfile.mkdtemp(prefix="rk-", dir=short))
        mark = uuid.uuid4().hex
        home = {MARK: mark, "FLWR_HOME": str(self._home), "RAY_TMPDIR": str(self._home)}
        self._environment = with_scripts(os.environ) | _SETTINGS | home
        self._children: list[subprocess.Popen[bytes]] = []
        self._processes = ProcessTracker(0, mark)
        try:
            self._run_id = self._start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: Any) -> None:
        """Ends whatever is left."""
        self._processes.end()
        for child in self._children:
            child.wait()
        shutil.rmtree(self._home, ignore_errors=True)

    def state(self) -> str:
        """``running`` and the like, or ``finished:completed``, ``finished:failed``."""
        (row,) = self._flwr("list", _CONNECTION, "--run-id", str(self._run_id))["runs"]
        return str(row["status"])

    def said(self, lines: int = 20) -> str:
        """The last lines of what the ServerApp printed."""
        command = ["flwr", "log", str(self._run_id), _CONNECTION, "--show"]
        return "\n".join(self._command(command).stdout.rstrip().splitlines()[-lines:])

    def roles(self) -> dict[str, list[Process]]:
        """Its processes by role."""
        return self._processes.roles()

    def _start(self) -> int:
        port = _free_port()
        (self._home / "config.toml").write_text(
            f'[superlink]\ndefault = "{_CONNECTION}"\n\n[superlink.{_CONNECTION}]\n'
            f'address = "{_HOST}:{port}"\ninsecure = true\n'
        )
        kind = [] if self._deployment else ["--simulation"]
        self._spawn("flower-superlink", "--insecure", *kind, "--host", _HOST, "--port", str(port))
        self._wait_for(port)
        options = ["--run-config", self._config]
        if self._deployment:
            for number in range(self._clients):
                place = f"partition-id={number} num-partitions={self._clients}"
                where = ["--superlink", f"{_HOST}:{port}", "--port", str(_free_port())]
                self._spawn("flower-supernode", "--insecure", *where, "--node-config", place)
        else:
            # A CPU each, and as many as clients: Ray takes the number on trust.
            at_once = min(self._clients, os.cpu_count() or 1)
            ray = f"client-resources-num-cpus=1 init-args-num-cpus={at_once}"
            options += ["--federation-config", f"num-supernodes={self._clients} {ray}"]
        return int(self._flwr("run", str(self._app), _CONNECTION, *options)["run-id"])

    def _spawn(self, *command: str) -> None:
        with (self._home / "log").open("ab") as log:
            self._children.append(started_apart(command, self._home, self._environment, log))

    def _wait_for(self, port: int) -> None:
        deadline = time.monotonic() + _COMMAND_S
        while True:
            with socket.socket() as probe:
                if probe.connect_ex((_HOST, port)) == 0:
                    return
            if self._children[0].poll() is not None or time.monotonic() > deadline:
                raise LiveError(f"The SuperLink did not start: {self._log()}")
            time.sleep(0.1)

    def _log(self) -> str:
        return (self._home / "log").read_text(errors="replace")[-2000:]

    def _flwr(self, *arguments: str) -> Any:
        done = self._command(["flwr", *arguments, "--format", "json"])
        try:
            answer = json.loads(done.stdout)
        except json.JSONDecodeError:
            answer = {}
        if done.returncode or not answer.get("success"):
            why = answer.get("error-message") or (done.stdout + done.stderr)[-2000:]
            raise LiveError(f"`flwr {arguments[0]}` failed: {why.strip()}")
        return answer

    def _command(self, command: list[str]) -> subprocess.CompletedProcess[str]:
        try:
            return subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                cwd=self._home,
                env=self._environment,
                timeout=_COMMAND_S,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            said = f"`{' '.join(command[:2])}` gave no answer within {_COMMAND_S:.0f} s"
            raise LiveError(said) from error


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((_HOST, 0))
        return int(probe.getsockname()[1])
