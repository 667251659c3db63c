"""``runtime=simulation`` and ``runtime=deployment``: the app on Flower."""

from __future__ import annotations

import dataclasses
import shlex
import time
from contextlib import suppress
from typing import Any

from conf import Config, flower_clients, has_rooms, to_yaml
from conf.errors import first_sentence
from experiments.flower.connection import Connection
from experiments.flower.control import RunState, Status
from experiments.flower.engine import SimulationSuperLink
from experiments.flower.environment import FlowerError, ProcessLostError, UnansweredError
from experiments.flower.federation import Federation
from experiments.flower.superlink import SuperLink
from lockstep import LinkTimeout, RobotLost
from storage.checkpoint_files import CheckpointError
from training.checkpoint import Checkpoint, latest
from training.resume import kept_robots
from training.rooms import RoomsLostError
from training.run_folder import RunFolder

MOST_IN_VAIN = 3
"""Starts in a row without a new checkpoint before a run is given up."""

LOSSES = tuple(f"{kind.__name__}: " for kind in (RobotLost, LinkTimeout, RoomsLostError))
"""How the message of a run begins that has lost a robot or a room."""


Runner = SuperLink | Connection
"""Where runs of the app are handed in."""


def train(config: Config, folder: RunFolder, resumed: Checkpoint | None = None) -> dict[str, Any]:
    """Trains on Flower: on processes of this run's own, which end with it, or on a federation.

    The configuration has an absolute ``run.dir`` and a ``run.id``.

    Returns:
        What ``summary.json`` holds; nothing where the ServerApp's machine is another.

    Raises:
        FlowerError: Flower or the run failed; the message holds the end of the log.
    """
    federation = dataclasses.replace(config.federation, clients=flower_clients(config))
    config = dataclasses.replace(config, federation=federation)
    folder.write_config(config)
    try:
        restarts = _run_with_restarts(config, folder, resumed)
    except BaseException as error:
        folder.report_failure(error)
        raise
    if not folder.summary_file.exists():
        return {}
    summary = folder.read_summary() | {"restarts": restarts}
    with suppress(OSError):  # the ServerApp has written all else
        folder.write_summary(summary)
    return summary


def _run_with_restarts(config: Config, folder: RunFolder, resumed: Checkpoint | None) -> list[str]:
    """Runs to the end; where processes died that this has started, starts them again, says why.

    Raises:
        FlowerError: the run failed, or they die again and again.
    """
    reached, in_vain = -1 if resumed is None else resumed.window, 0
    revives = config.federation.on_loss != "abort" and config.runtime.connection is None
    restarts: list[str] = []
    while True:
        try:
            _run(config, folder, resumed is not None)
            return restarts
        except ProcessLostError as error:
            if folder.summary_file.exists():
                return restarts  # it was done: what died had nothing left to do
            if not revives:
                raise
            resumed = _last(config, folder)
            window = 0 if resumed is None else resumed.window
            reached, in_vain = max(reached, window), 0 if window > reached else in_vain + 1
            if in_vain > MOST_IN_VAIN:
                raise
            sentence = first_sentence(error).removesuffix(".")
            restarts.append(f"{sentence}. Starting again from window {window}.")
            with suppress(OSError):
                folder.progress_file.unlink(missing_ok=True)
            with suppress(OSError):
                folder.report_state("waiting", restarts[-1])


def _last(config: Config, folder: RunFolder) -> Checkpoint | None:
    """Where a run goes on that was cut off; None if it must begin again."""
    try:
        rooms = has_rooms(config)
        return latest(folder.state, kept_robots(config), config.run.id, rooms=rooms)
    except CheckpointError:
        folder.metrics_file.unlink(missing_ok=True)  # or it would not be taken for a new run
        return None


def _run(config: Config, folder: RunFolder, resumes: bool) -> None:
    """Hands the run in and waits for its end."""
    what = f"resume={folder}" if resumes else to_yaml(config)
    with _runner(config, folder) as runner:
        run_id = runner.submit(shlex.quote(what))
        status = _awaited(runner, run_id, config.runtime.start_timeout_s)
        if status.state is not RunState.COMPLETED:
            raise _failure(folder, status, runner.log_tail(run_id))


def _awaited(runner: Runner, run_id: int, patience_s: float) -> Status:
    """How a run ended. That nobody says how it goes is no end of it, for some time.

    Raises:
        UnansweredError: there was no answer for ``patience_s``.
        FlowerError: see ``Runner.status``.
    """
    heard = time.monotonic()
    while True:
        try:
            status = runner.status(run_id)
        except UnansweredError:
            if time.monotonic() - heard > patience_s:
                raise
        else:
            heard = time.monotonic()
            if status.finished:
                return status
        time.sleep(runner.poll_s)


def _runner(config: Config, folder: RunFolder) -> Runner:
    clients, patience_s = flower_clients(config), config.runtime.start_timeout_s
    if config.runtime.name == "simulation":
        return SimulationSuperLink(
            clients=clients, log_path=folder.log_file, start_timeout_s=patience_s
        )
    if config.runtime.connection is not None:
        return Connection(config.runtime.connection)
    return Federation(
        nodes=clients,
        secure=config.runtime.secure,
        revive=config.federation.on_loss != "abort",
        log_path=folder.log_file,
        start_timeout_s=patience_s,
    )


def _failure(folder: RunFolder, status: Status, log_tail: str) -> FlowerError:
    """What went wrong in one sentence, and the log where the run itself could not say."""
    message = folder.failure
    if message is not None:
        kind = ProcessLostError if message.startswith(LOSSES) else FlowerError
        return kind(f"The run failed: {message} (log: {folder.log_file})")
    kind = FlowerError if status.details.startswith("ServerApp failed") else ProcessLostError
    return kind(f"The run ended as {status.state}. {status.details}".strip(), log_tail)
