"""Rooms of a building, as their host has them: world, access point and robots in one process.

A room is Algorithm 1 as the local runtime plays it, in parts: each round it takes the network that
all rooms share, plays some windows and hands its own on.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from client_app.robots import RobotGroup
from conf import Config
from conf.rooms import room_name
from env.episode import EpisodeMeasures
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World
from lockstep import InProcessFleet
from storage.checkpoint_files import checkpoints, drop_between, load_checkpoint, save_checkpoint
from storage.checkpoint_layout import room_folder, room_owner
from training.checkpoint import flat, part
from training.controllers.access_point import NetworkAgent
from training.controllers.schemes import build_ris_controller
from training.coordinator import Coordinator
from training.exchange.federation import build_federation
from training.partition import step_layout
from training.recording.history import METRICS, episode_row
from training.recording.progress import Progress
from training.rooms import RoomReport, RoomTask, RoundTask, Weights

log = logging.getLogger(__name__)


class RoomRobots(RobotGroup):
    """The robots of a room; between rounds they stay as they are and take a network."""

    def windows(self) -> list[int]:
        """See ``lockstep.Robots.windows``: the room keeps checkpoints, not they."""
        return []

    def begin(self, window: int, model: Weights | None) -> None:
        """See ``lockstep.Robots.begin``."""
        if model is not None:
            self.download(window, model)


class HostedRoom:
    """One room, which implements ``training.recording.progress.Observer``.

    Args:
        config: of the room, as ``conf.rooms.Room.config`` makes it.

    Attributes:
        parameters: P, of the robots' network.
    """

    def __init__(self, config: Config) -> None:
        robots = tuple(range(config.env.robots))
        scenario = Scenario.drawn(config.env, config.seed)
        world = World(scenario, stream(config.seed, Stream.WORLD), config.train.worlds)
        self._config = config
        self._ap = build_ris_controller(config, world)
        self._group = RoomRobots(config, robots)
        self._fleet = InProcessFleet([(robots, self._group)], step_layout(config))
        self._coordinator = Coordinator(
            config, world, self._ap, self._fleet, build_federation(config), self, stop=self._is_due
        )
        self._until = 0
        self._rows: list[list[float]] = []
        self.parameters = self._group.parameters
        self._coordinator.begin(np.zeros((2, self.parameters), np.float32))

    def play(self, windows: int, model: Weights, ap: Weights | None = None) -> RoomReport:
        """Plays so many windows from a network on.

        Args:
            windows: how many.
            model: what all robots take, online and target, shape (2, P).
            ap: what the access point takes, shape (2, P_AP); None leaves it as it is.
        """
        progress, self._rows = self._coordinator.progress, []
        self._until = progress.window + windows
        if ap is not None and isinstance(self._ap, NetworkAgent):
            self._ap.agent.load(ap)
        self._fleet.begin(progress.window, model)
        robots = self._coordinator.play(model)
        episodes = np.array(self._rows, dtype=np.float64).reshape(-1, len(METRICS))
        return RoomReport(robots[0], self._ap.weights(), progress.tick, episodes)

    def state(self) -> dict[str, NDArray[Any]]:
        """All that the room needs to go on from the end of a round."""
        robots = {f"robot-{k}": self._group.robot_state(k) for k in self._group.robots}
        return {**self._coordinator.state(), **flat(robots)}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave."""
        self._coordinator.begin(np.zeros((2, self.parameters), np.float32), state)
        for robot in self._group.robots:
            self._group.restore_robot(robot, part(state, f"robot-{robot}"))

    def on_start(self) -> None:
        """See ``Observer.on_start``."""

    def on_episode(self, progress: Progress, measures: EpisodeMeasures) -> None:
        """See ``Observer.on_episode``."""
        row = episode_row(self._config, progress, measures)
        self._rows.append([row[name] for name in METRICS])

    def on_window(self, progress: Progress, robots: Weights, ap: Weights) -> None:
        """See ``Observer.on_window``."""

    def _is_due(self) -> bool:
        return self._coordinator.progress.window >= self._until


@dataclass
class RoomKeeper:
    """The rooms that one process hosts, with their checkpoints.

    Attributes:
        config: of the building.
        state: the folder of checkpoints on this machine; None keeps none.
        rooms: those that this process has at hand, and the round that each has last played.
        kept: the round of each room's last checkpoint, of those that this process has written.
    """

    config: Config
    state: Path | None
    rooms: dict[str, tuple[HostedRoom, int]] = field(default_factory=dict)
    kept: dict[str, int] = field(default_factory=dict)

    def play(self, task: RoundTask) -> dict[int, RoomReport]:
        """Plays a round in each room that takes part, one after the other.

        Rooms do not meet within a round, so no order of theirs changes a bit.

        Raises:
            CheckpointError: the checkpoint that a room goes on from is missing or damaged.
            OSError: a checkpoint could not be written.
        """
        reports = {}
        for asked in task.rooms:
            room, name = self._taken(asked), asked.room.name
            reports[asked.room.index] = room.play(self.config.rooms.every, task.model, asked.ap)
            self.rooms[name] = (room, task.number)
            if task.keep and self.state is not None:
                drop_between(room_folder(self.state, name), asked.since, task.number)
                self._save(self.state, name)
        return reports

    def keep_only(self, names: Set[str]) -> None:
        """Lets go of all other rooms, which live on in their checkpoints."""
        self.rooms = {name: held for name, held in self.rooms.items() if name in names}

    def keep(self) -> None:
        """Writes a checkpoint of each room at hand that has none of the round it last played.

        Raises:
            OSError: one cannot be written.
        """
        if self.state is not None:
            for name, (_, played) in self.rooms.items():
                if self.kept.get(name) != played:
                    self._save(self.state, name)

    def _save(self, state: Path, name: str) -> None:
        room, played = self.rooms[name]
        owner = room_owner(self.config.run.id, name)
        save_checkpoint(room_folder(state, name), played, room.state(), owner)
        self.kept[name] = played

    def _taken(self, asked: RoomTask) -> HostedRoom:
        """The room as it was after the round that it goes on from, taken out of ``rooms``.

        There it would be half a round ahead if an error ended the other half.
        """
        name = asked.room.name
        room, played = self.rooms.pop(name, (None, 0))
        if room is not None and played == asked.since:
            return room
        room = None  # or two of them would be in memory
        room = HostedRoom(asked.room.config(self.config))
        if asked.since:
            folder = room_folder(self.state or Path(), name)
            owner = room_owner(self.config.run.id, name)
            room.restore(load_checkpoint(folder, asked.since, owner)[0])
        return room


def held_rooms(state: Path, rooms: int) -> list[int]:
    """The rooms, of the first so many, of which there is any checkpoint in a folder."""
    return [index for index in range(rooms) if checkpoints(room_folder(state, room_name(index)))]
