"""A building on Flower: clients host whole rooms, and a round is a message to each and its reply.

Rooms need no lockstep between hosts. A client that is lost in a round is asked again, on its node
or on another that holds its rooms, and plays the round from their checkpoints to the same bits.
"""

from __future__ import annotations

import dataclasses
import logging
import time
from collections.abc import Set
from functools import reduce
from typing import Any

from flwr.app import Message, MessageType
from flwr.serverapp import Grid

from conf import Config, fingerprint, flower_clients, weight_shapes
from lockstep.errors import one_line
from server_app.nodes import DIED, MOST_FAILURES, POLL_S, RoundError, held_by
from training.building import BuildingRun
from training.checkpoint import Checkpoint
from training.partition import Block, partition_robots
from training.recording.costs import Costs
from training.room_messages import asked, read_reply
from training.rooms import RoomReport, RoomsLostError, RoundTask
from training.run_folder import RunFolder
from training.run_log import log_lines

log = logging.getLogger(__name__)

LOOK_S = 1.0
"""Between two looks whether a client's node is there."""
PAUSE_S = 1.0
"""Between a round that all rooms have missed and the next try."""
AWAY = "its Flower node is not there"


class FlowerRooms:
    """The rooms of a building on Flower clients; implements ``training.rooms.RoomHost``.

    The configuration has an absolute ``run.dir`` and a ``run.id``.
    """

    forgets = True

    def __init__(self, config: Config, grid: Grid) -> None:
        self._config, self._grid = config, grid
        self._rooms = partition_robots(config.rooms.count, flower_clients(config))
        self._places: dict[Block, int] = {}
        self._missed: dict[Block, str] = {}
        self._fingerprint = fingerprint(config.env)
        self._costs: dict[Block, Costs] = dict.fromkeys(self._rooms, Costs())

    def keep(self) -> None:
        """See ``RoomHost.keep``: they have, at the end of each round."""

    def costs(self) -> Costs:
        """See ``RoomHost.costs``."""
        return reduce(Costs.plus, self._costs.values(), Costs())

    def clients(self) -> list[dict[str, Any]]:
        """See ``RoomHost.clients``."""
        online = set(self._grid.get_node_ids())
        return [
            {
                "rooms": list(block),
                "connected": self._places.get(block) in online,
                "missed": self._missed.get(block),
                "flower_bytes": costs.flower_bytes,
                "cpu_s": costs.client_cpu_s,
            }
            for block, costs in self._costs.items()
        ]

    def play(self, task: RoundTask) -> dict[int, RoomReport]:
        """See ``RoomHost.play``; a round that all rooms miss is played again.

        Raises:
            RoomsLostError: a client's process or node is gone, and is not waited for, or in vain.
            RoundError: a client fails again and again, or replies what it was not asked.
        """
        began = time.perf_counter()
        patience_s = self._config.federation.loss_timeout_s
        while not (reports := self._played(task)):
            if time.perf_counter() - began > patience_s:
                why = {reason for reason in self._missed.values() if reason}
                if why == {AWAY} and list(self._grid.get_node_ids()):
                    return {}  # others are there
                raise RoomsLostError(
                    f"round {task.number}: no room could be reached for {patience_s:g} s"
                    f" ({'; '.join(sorted(why))})"
                )
            time.sleep(PAUSE_S)
        log.info("round %d: %.1f s", task.number, time.perf_counter() - began)
        return reports

    def _played(self, task: RoundTask) -> dict[int, RoomReport]:
        rounds = []
        for block in self._rooms:
            own = [each for each in task.rooms if each.room.index in block]
            if own:
                rounds.append(_ClientRound(self, block, dataclasses.replace(task, rooms=own)))
        while open_rounds := [each for each in rounds if not each.done]:
            waiting = {each.sent: each for each in open_rounds if each.sent}
            for reply in self._grid.pull_messages(list(waiting)):
                waiting[reply.metadata.reply_to_message_id].take(reply)
            for each in open_rounds:
                each.tend()
            if not all(each.done for each in open_rounds):
                time.sleep(POLL_S)
        self._missed = {each.block: "" if each.reports else each.reason for each in rounds}
        return {room: report for each in rounds for room, report in each.reports.items()}

    def node_for(self, block: Block, played: Set[int]) -> int | None:
        """The node to ask for a client's rooms: its own while that is there, or one that is free.

        The checkpoints of its rooms that have played must be on the node; of a client none of
        whose rooms has, no other's may be, or it would take that one's place.
        """
        online = set(self._grid.get_node_ids())
        if self._places.get(block) in online:
            return self._places[block]
        free = sorted(online - set(self._places.values()))
        if played and free and self._config.runtime.connection is not None:
            held = held_by(self._grid, self._config, free)
            if own := played & set(block):
                free = [node for node in free if own <= held[node]]
            else:
                elsewhere = {room for placed in self._places for room in placed}
                fresh = [node for node in free if not held[node] & played]
                free = fresh or [node for node in free if held[node] <= elsewhere]
        if not free:
            return None
        self._places[block] = free[0]
        return free[0]

    def send(self, node: int, task: RoundTask, block: Block) -> str:
        """Asks a client; returns the message's name, empty where Flower does not take it."""
        content = asked(self._config, self._fingerprint, task)
        weights = sum(record.count_bytes() for record in content.array_records.values())
        self._costs[block] = self._costs[block].plus(Costs(flower_bytes=weights))
        message = Message(
            content=content,
            message_type=MessageType.TRAIN,
            dst_node_id=node,
            group_id=str(task.number),
        )
        [name] = self._grid.push_messages([message])
        return name or ""

    def read(self, reply: Message, task: RoundTask, block: Block) -> dict[int, RoomReport]:
        """What a client's reply says.

        Raises:
            RoundError: it is not what was asked.
        """
        shapes = {
            each.room.index: {
                "model": task.model.shape,
                "ap": weight_shapes(each.room.config(self._config))["ap"],
            }
            for each in task.rooms
        }
        try:
            reports, spent = read_reply(reply.content, shapes)
        except (LookupError, TypeError, ValueError) as error:
            raise RoundError(f"round {task.number}: {error}") from error
        more = Costs(client_cpu_s=spent.cpu_s, flower_bytes=spent.nbytes)
        self._costs[block] = self._costs[block].plus(more)
        return reports

    def is_online(self, block: Block) -> bool:
        """Whether the node of a client is there."""
        return self._places.get(block) in set(self._grid.get_node_ids())


class _ClientRound:
    """One client's part of a round.

    Attributes:
        done: whether nothing more is to come of it.
        sent: the name of the message that is out, empty if none is.
        reports: of its rooms, once it is done; none where they miss the round.
        block: the client's rooms.
        reason: what last went wrong.
    """

    def __init__(self, host: FlowerRooms, block: Block, task: RoundTask) -> None:
        self._host, self.block, self._task = host, block, task
        self._config = host._config
        self.done, self.sent = False, ""
        self.reports: dict[int, RoomReport] = {}
        self.reason = AWAY
        self._failures = 0
        self._lost_at: float | None = None
        self._looked = 0.0

    def take(self, reply: Message) -> None:
        """Takes the reply to the message that is out."""
        self.sent = ""
        if not reply.has_error():
            self.reports, self.done = self._host.read(reply, self._task, self.block), True
            return
        reason = one_line(str(reply.error.reason))
        if self._config.runtime.name == "simulation" and DIED in reason:
            raise RoomsLostError(f"{self._named()}: its process died without a word")
        self._failures += 1
        if self._failures > MOST_FAILURES or self._config.federation.on_loss == "abort":
            raise RoundError(f"{self._named()} failed: {reason}")
        log.warning("%s failed: %s", self._named(), reason)
        self.reason = reason
        self._lose()

    def tend(self) -> None:
        """Asks the client if it is not asked, and looks once a second whether its node is there."""
        if self.done or (self.sent and time.monotonic() - self._looked < LOOK_S):
            return
        self._looked = time.monotonic()
        if self.sent and not self._host.is_online(self.block):
            self.sent = ""
            self._lose()
        if self.done or self.sent:
            return
        node = self._host.node_for(self.block, self._task.played)
        if node is not None:
            self.sent = self._host.send(node, self._task, self.block)
        if self.sent:
            self._lost_at = None
        else:
            self._lose()

    def _lose(self) -> None:
        """Its node or process is gone: waits for it, or goes on without.

        Raises:
            RoomsLostError: it is not waited for, or has been for too long.
        """
        federation = self._config.federation
        if federation.on_loss == "miss":
            log.warning("%s: its rooms miss the round", self._named())
            self.done = True
            return
        now = time.monotonic()
        self._lost_at = self._lost_at or now
        if federation.on_loss == "abort" or now - self._lost_at > federation.loss_timeout_s:
            raise RoomsLostError(f"{self._named()}: its Flower node has gone")
        time.sleep(POLL_S)

    def _named(self) -> str:
        first, last = self.block[0], self.block[-1]
        rooms = f"room {first}" if first == last else f"rooms {first} to {last}"
        return f"round {self._task.number}: the Flower client of {rooms}"


def train_building(
    grid: Grid, config: Config, folder: RunFolder, resumed: Checkpoint | None
) -> None:
    """Trains a building with a federation's clients, from a checkpoint where there is one.

    The configuration has an absolute ``run.dir`` and a ``run.id``.
    """
    with log_lines(config.run.id):
        BuildingRun(config, folder, resumed).train(FlowerRooms(config, grid))
