"""``runtime=simulation``: the app on Flower's simulation runtime, on this machine."""

from __future__ import annotations

import dataclasses
import json
import shlex
import time
from pathlib import Path
from typing import Any

from conf import Config, flower_clients, to_yaml
from experiments.display import read_progress
from experiments.flower import FlowerError, RunState, SimulationSuperLink, Status
from server_app import resume
from server_app.checkpoint import Checkpoint
from server_app.recorder import report_failure, write_atomically

POLL_S = 1.0
LOG_NAME = "flower.log"


def train(config: Config, folder: Path, resumed: Checkpoint | None = None) -> dict[str, Any]:
    """Trains on a SuperLink of this run's own, which ends with it.

    Args:
        config: the run's configuration, with an absolute ``run.dir``.
        folder: the run's folder.
        resumed: where the run goes on, if it does not begin.

    Returns:
        What ``summary.json`` holds.

    Raises:
        FlowerError: Flower or the run failed; the message holds the end of the log.
    """
    federation = dataclasses.replace(config.federation, clients=flower_clients(config))
    config = dataclasses.replace(config, federation=federation)
    write_atomically(folder / "config.yaml", to_yaml(config))
    try:
        written = f"@{folder / 'config.yaml'}"
        _run(config, folder, f"{resume.PREFIX}{folder}" if resumed else written)
    except BaseException as error:
        report_failure(folder, error)
        raise
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return summary


def _run(config: Config, folder: Path, what: str) -> None:
    """Hands the run that ``what`` describes to a SuperLink and waits for its end."""
    superlink = SimulationSuperLink(
        log_path=folder / LOG_NAME, start_timeout_s=config.runtime.start_timeout_s
    )
    with superlink:
        run_id = superlink.submit(clients=flower_clients(config), overrides=shlex.quote(what))
        while not (status := superlink.status(run_id)).finished:
            time.sleep(POLL_S)
        if status.state is not RunState.COMPLETED:
            raise FlowerError(*_failure(folder, status, superlink.log_tail(run_id)))


def _failure(folder: Path, status: Status, log_tail: str) -> tuple[str, str]:
    """What went wrong in one sentence, and the log where the run itself could not say."""
    progress = read_progress(folder)
    if progress is not None and progress["state"] == "failed":
        return f"The run failed: {progress['message']} (log: {folder / LOG_NAME})", ""
    return f"The run ended as {status.state}. {status.details}".strip(), log_tail
