"""The `flwr` commands, asked for JSON: the documented way to hand in a run and to ask after it.

Each raises a FlowerError where Flower refuses, or does not answer.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from experiments.flower.control import ControlError, Status, parse_status
from experiments.flower.environment import (
    CONNECTION,
    FlowerError,
    UnansweredError,
    flower_command,
    tail,
)
from experiments.flower.manifest import Components, write_manifest, write_run_config
from experiments.flower.session import Session
from experiments.flower.variables import proxies

_TIMEOUT_S = 60.0
_SOCKS = "socksio"


def submit_run(
    session: Session,
    overrides: str,
    components: Components,
    *,
    simulated: int | None = None,
    connection: str = CONNECTION,
) -> int:
    """Hands a run to a SuperLink; returns its number.

    Args:
        session: with the connection in its folder, unless the user's own is named.
        overrides: the run's configuration value.
        components: the app's parts.
        simulated: simulated nodes, all of which get a process of their own; None in a deployment.
        connection: a name in Flower's configuration.

    Raises:
        FlowerError: Flower refuses, or does not answer.
    """
    app = write_manifest(session.folder / "app", components)
    config = write_run_config(session.folder / "run.toml", overrides)
    options = ["--run-config", str(config)]
    if simulated is not None:
        # One CPU a client, and as many CPUs as clients: Ray takes the number on trust.
        resources = f"client-resources-num-cpus=1 init-args-num-cpus={simulated}"
        options += ["--federation-config", f"num-supernodes={simulated} {resources}"]
    return int(_flwr(session, "run", str(app), connection, *options)["run-id"])


def register_node(session: Session, public_key: Path) -> None:
    """Lets a SuperNode with the key in this file join the session's SuperLink."""
    _flwr(session, "supernode", "register", str(public_key), CONNECTION)


def stop_run(session: Session, run_id: int, connection: str) -> None:
    """Ends a run that is going on."""
    _flwr(session, "stop", str(run_id), connection)


def run_log(session: Session, run_id: int, connection: str) -> str:
    """What the ServerApp has printed so far."""
    command = [flower_command("flwr"), "log", str(run_id), connection, "--show"]
    return session.run(command, _TIMEOUT_S)[1]


def run_status(session: Session, run_id: int, connection: str = CONNECTION) -> Status:
    """State of a run, at more than a second of CPU.

    Raises:
        UnansweredError: Flower refuses, or does not answer.
        FlowerError: it answers what nobody here understands.
    """
    try:
        rows = _flwr(session, "list", connection, "--run-id", str(run_id)).get("runs")
    except FlowerError as error:
        raise UnansweredError(str(error)) from error
    if not rows:
        raise UnansweredError(f"`flwr list` knows of no run {run_id}.")
    try:
        return parse_status(rows[0]["status"], rows[0]["status-details"])
    except ControlError as error:
        raise FlowerError(f"`flwr list` says something new: {error}.") from error


def _flwr(session: Session, verb: str, *arguments: str) -> Any:
    command = [flower_command("flwr"), verb, *arguments, "--format", "json"]
    code, output, errors = session.run(command, _TIMEOUT_S)
    try:
        answer = json.loads(output)
    except json.JSONDecodeError:
        answer = {}
    if code == 0 and answer.get("success"):
        return answer
    reason = answer.get("error-message") or tail(output + errors, 20)
    if _SOCKS in reason:
        raise FlowerError(
            f"`flwr {verb}` is to go through a SOCKS proxy ({', '.join(proxies())}), for which"
            f" Flower needs the package {_SOCKS}: `pip install {_SOCKS}` where RISFleet is"
            " installed, or leave these variables out."
        )
    raise FlowerError(f"`flwr {verb}` failed.", reason.strip())
