"""What a building asks of whoever hosts its rooms, and what comes back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from conf import Config, ConfigError
from conf.rooms import Room, from_json, rooms_of, to_json
from env.texts import read_text
from storage.atomic import write_atomically
from training.recording.costs import Costs
from training.run_folder import RunFolder

Weights = NDArray[np.float32]


class RoomsLostError(RuntimeError):
    """The process or node that hosts some rooms is gone; the message says which."""


@dataclass(frozen=True, eq=False)
class RoomTask:
    """What a room is asked in a round.

    Attributes:
        room: which it is.
        since: the round after which its last checkpoint was written; 0 before its first round.
        ap: the access point's network to take, online and target, shape (2, P_AP), or None where
            it goes on from its own.
    """

    room: Room
    since: int
    ap: Weights | None = None


@dataclass(frozen=True, eq=False)
class RoomReport:
    """What a room has come to in a round.

    Attributes:
        model: its robots' network after the last average inside the room, shape (2, P).
        ap: the access point's, shape (2, P_AP); P_AP is 0 where it learns nothing.
        ticks: joint steps that the room has played in all.
        episodes: a row for each episode that ended in this round, columns as
            ``recording.history.METRICS``.
    """

    model: Weights
    ap: Weights
    ticks: int
    episodes: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RoundTask:
    """What the rooms of a building are asked in a round.

    Attributes:
        number: the round's, from 1.
        model: the robots' network that all rooms start from, shape (2, P).
        keep: whether rooms write checkpoints at its end, or when ``RoomHost.keep`` says so.
        rooms: those that take part, in order.
        played: those of the building that have played before, and have a checkpoint somewhere;
            for whoever deals rooms to hosts, not sent to them.
    """

    number: int
    model: Weights
    keep: bool
    rooms: Sequence[RoomTask]
    played: frozenset[int] = frozenset()


class RoomHost(Protocol):
    """Where the rooms of a building live: this process, or Flower clients.

    Attributes:
        forgets: whether rooms live on from round to round in their checkpoints alone.
    """

    forgets: bool

    def play(self, task: RoundTask) -> dict[int, RoomReport]:
        """Plays a round in every room that takes part.

        Returns:
            The report of each room, by its index; rooms that could not be reached are missing.
        """
        ...

    def keep(self) -> None:
        """Sees to it that each room has a checkpoint of the round that it last played."""
        ...

    def costs(self) -> Costs:
        """What the runtime has cost so far."""
        ...

    def clients(self) -> list[dict[str, Any]]:
        """Each Flower client: its rooms, and what it has cost; none within one process."""
        ...


def known_rooms(config: Config, folder: RunFolder) -> list[Room]:
    """A building's rooms: as its folder says, or drawn and written there.

    Raises:
        ConfigError: see ``conf.rooms.rooms_of``.
    """
    path = folder.rooms_file
    if path.is_file():
        try:
            rooms = from_json(read_text(path))
        except (OSError, ValueError) as error:
            raise ConfigError(f"{path} cannot be read: {error}.") from error
        own = [(False, index) for index in range(config.rooms.count)]
        own += [(True, index) for index in range(config.rooms.held_out)]
        if [(room.held_out, room.index) for room in rooms] != own:
            raise ConfigError(f"{path}: its rooms are not those of the run's configuration.")
        return rooms
    rooms = rooms_of(config, check=False)  # as was done before the run began
    write_atomically(path, to_json(rooms))
    return rooms
