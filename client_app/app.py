"""The ClientApp: wraps robots' DQNs and their slices of the environment for one round."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from flwr.app import Array, ArrayRecord, ConfigRecord, Context, Message, MetricRecord, RecordDict
from flwr.clientapp import ClientApp

from agent import single_threaded
from client_app.rooms import RoomKeeper, held_rooms
from client_app.state import CheckpointedRobots, held_robots
from conf import Config, fingerprint, from_yaml, has_rooms, waits_for_the_lost
from lockstep import serve
from lockstep.tls import client_context
from storage.checkpoint_layout import node_folder
from training.partition import step_layout
from training.room_messages import ROOMS, read_asked, replied
from training.run_folder import RunFolder
from training.run_log import log_lines

STATE_DIR = "state-dir"
"""The key of a SuperNode's ``--node-config`` that names the folder of its robots' state."""

log = logging.getLogger(__name__)
app = ClientApp()

_keepers: dict[str, RoomKeeper] = {}
"""The rooms of the run that this process played last, by its folder of checkpoints: a process of
the simulation lives on from message to message."""


@dataclass(frozen=True)
class RoundConfig:
    """What the ServerApp asks of a client in a round.

    Attributes:
        config: the run's configuration.
        robots: the robots that this client holds.
        tokens: a secret for each of them, for this round.
        address: host and port of the link.
        window: the windows that have been played before this round.
        round: the round's number.
        certificate: of the link's server, PEM; empty without TLS.
    """

    config: Config
    robots: tuple[int, ...]
    tokens: Sequence[str]
    address: tuple[str, int]
    window: int
    round: int
    certificate: str

    @classmethod
    def read(cls, record: ConfigRecord) -> RoundConfig:
        """Reads the order out of a train message."""
        return cls(
            config=from_yaml(str(record["config"])),
            robots=tuple(int(robot) for robot in record["robots"]),  # type: ignore[union-attr]
            tokens=[str(token) for token in record["tokens"]],  # type: ignore[union-attr]
            address=(str(record["host"]), int(record["port"])),  # type: ignore[arg-type]
            window=int(record["window"]),  # type: ignore[arg-type]
            round=int(record["round"]),  # type: ignore[arg-type]
            certificate=str(record["certificate"]),
        )


@app.train()
def train(message: Message, context: Context) -> Message:
    """Serves one round of windows and replies with the robots' weights, or those of its rooms."""
    single_threaded()
    began = time.process_time()
    if ROOMS in message.content.config_records:
        return _play_rooms(message, context)
    order = RoundConfig.read(message.content.config_records["order"])
    model = message.content.array_records["arrays"].get("model")
    folder = state_folder(order.config, context.node_config)
    with (
        log_lines(order.config.run.id, order.round, order.robots),
        closing(CheckpointedRobots(order.config, order.robots, folder)) as keeper,
    ):
        keeper.begin(order.window, None if model is None else model.numpy())
        _serve(order, keeper)
        content = RecordDict(
            {
                "arrays": ArrayRecord({"robots": Array(keeper.upload())}),
                "metrics": MetricRecord({"cpu_s": time.process_time() - began}),
            }
        )
    return Message(content=content, reply_to=message)


def _play_rooms(message: Message, context: Context) -> Message:
    """Plays a round in the rooms that this client hosts."""
    began = time.process_time()
    config, version, task = read_asked(message.content)
    if version != fingerprint(config.env):
        raise RuntimeError(
            "this node has another version of RISFleet, torch or plug-ins, or another type of CPU,"
            " than the ServerApp: its rooms would not end in the same bits"
        )
    state = state_folder(config, context.node_config)
    if str(state) not in _keepers:
        _keepers.clear()  # of an earlier run, where a process outlives one
        _keepers[str(state)] = RoomKeeper(config, state)
    keeper = _keepers[str(state)]
    rooms = [each.room.index for each in task.rooms]
    keeper.keep_only({each.room.name for each in task.rooms})  # any process may play any room
    with log_lines(config.run.id, task.number, rooms, "room"):
        reports = keeper.play(task)
    content = replied(reports, time.process_time() - began)
    return Message(content=content, reply_to=message)


@app.query()
def query(message: Message, context: Context) -> Message:
    """Replies which robots' state, or that of which rooms, this node holds."""
    order = message.content.config_records["order"]
    config = from_yaml(str(order["config"]))
    state = state_folder(config, context.node_config)
    rooms = has_rooms(config)
    held = held_rooms(state, config.rooms.count) if rooms else held_robots(state, config.env.robots)
    return Message(RecordDict({"held": ConfigRecord({"robots": held})}), reply_to=message)


def state_folder(config: Config, node_config: Mapping[str, object]) -> Path:
    """Where the robots of a run keep their state on this node.

    It is below the ``state-dir`` of the SuperNode's configuration, which is that of all runs;
    without one in the run's folder, as ``run.dir`` names it on the server.
    """
    own = node_config.get(STATE_DIR)
    if own is None:
        return RunFolder.of(config).state
    return node_folder(Path(str(own)), str(config.run.id))


def _serve(order: RoundConfig, keeper: CheckpointedRobots) -> None:
    """Serves the robots on the link until the round ends."""
    federation = order.config.federation
    context = client_context(order.certificate) if order.certificate else None
    log.info("joining %s:%d %s TLS", *order.address, "with" if context else "without")
    serve(
        order.address,
        order.robots,
        order.tokens,
        keeper,
        fingerprint=fingerprint(order.config.env),
        timeout_s=federation.link.timeout_s,
        idle_timeout_s=federation.link.patience_s,
        reconnect_timeout_s=federation.loss_timeout_s if waits_for_the_lost(order.config) else 0.0,
        n_parameters=keeper.parameters,
        client_context=context,
        layout=step_layout(order.config),
    )
    log.info("the round has ended")
