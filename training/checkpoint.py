"""A run's checkpoints: what the server keeps, and the last one that the server and all robots have.

All write at the same window boundaries: the server into ``state/server``, each robot into a folder
of its own. A checkpoint counts once all have it, so a run goes back to the newest window that is
whole on every side, and goes on from there to the bits of a run that was never interrupted.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conf.rooms import room_name
from storage.checkpoint_files import CheckpointError, Writer, checkpoints, load_checkpoint
from storage.checkpoint_layout import (
    owner,
    robot_owner,
    robot_windows,
    room_folder,
    room_owner,
    server_folder,
)
from training.recording.progress import Progress

log = logging.getLogger(__name__)
State = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Checkpoint:
    """What the server wrote at a window boundary.

    Attributes:
        window: windows that had been played.
        arrays: the coordinator's, see ``Coordinator.state``.
        meta: counters, and what the run had cost.
        passed_over: what is wrong with newer ones, a sentence each.
    """

    window: int
    arrays: State
    meta: dict[str, Any]
    passed_over: tuple[str, ...] = ()

    @property
    def progress(self) -> Progress:
        """How far the run had come."""
        return Progress.of(self.arrays["run/progress"])

    @property
    def model(self) -> NDArray[np.float32] | None:
        """The global model, shape (2, P); None where robots keep their own weights."""
        return self.arrays.get("run/model")


def save_server(
    writer: Writer, state: Path, window: int, arrays: State, meta: Mapping[str, Any]
) -> None:
    """Writes the server's checkpoint of a window, once the one before it is there.

    Raises:
        OSError: the one before it could not be written.
    """
    writer.wait()
    writer.save(server_folder(state), window, arrays, meta)


def latest(state: Path, robots: int, run: str | None = None, *, rooms: bool = False) -> Checkpoint:
    """The newest checkpoint that the server and every robot or room have, whole and unchanged.

    Args:
        state: the run's folder of checkpoints.
        robots: K; 0 where their checkpoints lie on other machines.
        run: the run's identity; None takes any.
        rooms: whether the rooms of a building have theirs here, too.

    Raises:
        CheckpointError: there is none; the message says what is wrong with the newest one.
    """
    places = [robot_windows(state, robot) for robot in range(robots)]
    whom = f"the server and all {robots} robots have" if robots else "the server has"
    common = set(checkpoints(server_folder(state))).intersection(*places)
    trouble: list[CheckpointError] = []
    for window in sorted(common, reverse=True):
        try:
            for robot, place in enumerate(places):
                load_checkpoint(place[window], window, robot_owner(run, robot))
            arrays, meta = load_checkpoint(server_folder(state), window, owner(run))
            if rooms:
                _check_rooms(state, arrays["run/played"], run)
        except CheckpointError as error:
            trouble.append(error)
        else:
            return Checkpoint(window, arrays, meta, tuple(map(str, trouble)))
    raise trouble[0] if trouble else CheckpointError(f"{state} holds no checkpoint that {whom}")


def _check_rooms(state: Path, played: NDArray[Any], run: str | None) -> None:
    """Reads the checkpoint of the round that each room has last played."""
    for index, number in enumerate(played.tolist()):
        if number:
            name = room_name(index)
            load_checkpoint(room_folder(state, name), number, room_owner(run, name))


def newest(state: Path, windows: Iterable[int], run: str | None = None) -> Checkpoint | None:
    """The newest of the server's checkpoints of these windows that is whole, if one is.

    ``state`` and ``run`` as in ``latest``.
    """
    for window in sorted(windows, reverse=True):
        try:
            return Checkpoint(window, *load_checkpoint(server_folder(state), window, owner(run)))
        except CheckpointError as error:
            log.warning("the server cannot go on from window %d: %s", window, error)
    return None


def flat(parts: Mapping[str, State]) -> dict[str, NDArray[Any]]:
    """One mapping of the arrays of several parts, named ``part/name``."""
    return {f"{part}/{name}": a for part, arrays in parts.items() for name, a in arrays.items()}


def part(arrays: State, name: str) -> dict[str, NDArray[Any]]:
    """The arrays of one part, as ``flat`` took them."""
    own = f"{name}/"
    return {key.removeprefix(own): a for key, a in arrays.items() if key.startswith(own)}
