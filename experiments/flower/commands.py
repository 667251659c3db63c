"""The `flwr` commands, asked for JSON: the documented way to hand in a run and to ask after it."""

from __future__ import annotations

import json
from typing import Any

from experiments.flower.control import ControlError, Status, parse_status
from experiments.flower.environment import CONNECTION, FlowerError, flower_command, tail
from experiments.flower.manifest import Components, write_manifest, write_run_config
from experiments.flower.session import Session

_TIMEOUT_S = 60.0


def submit_run(session: Session, clients: int, overrides: str, components: Components) -> int:
    """Hand a run to the session's SuperLink.

    Args:
        session: with the connection in its folder.
        clients: simulated nodes, all of which get a process of their own.
        overrides: the run's configuration value.
        components: the app's parts.

    Returns:
        The run's number.

    Raises:
        FlowerError: Flower refuses, or does not answer.
    """
    app = write_manifest(session.folder / "app", components)
    config = write_run_config(session.folder / "run.toml", overrides)
    # One CPU a client, and as many CPUs as clients: Ray takes the number on trust.
    resources = f"client-resources-num-cpus=1 init-args-num-cpus={clients}"
    federation = f"num-supernodes={clients} {resources}"
    options = ["--run-config", str(config), "--federation-config", federation]
    return int(_flwr(session, "run", str(app), CONNECTION, *options)["run-id"])


def run_status(session: Session, run_id: int) -> Status:
    """State of a run, at more than a second of CPU.

    Args:
        session: with the connection in its folder.
        run_id: the run's number.

    Returns:
        The state.

    Raises:
        FlowerError: Flower refuses, or does not answer.
    """
    row = _flwr(session, "list", CONNECTION, "--run-id", str(run_id))["runs"][0]
    try:
        return parse_status(row["status"], row["status-details"])
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
    raise FlowerError(f"`flwr {verb}` failed.", reason.strip())
