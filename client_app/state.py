"""A robot's state on disk: what it has learned from stays with it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from client_app.robots import RobotGroup
from conf import Config
from lockstep import Expect, Payload, Step
from storage.checkpoint_files import CheckpointError, Writer, load_checkpoint, save_checkpoint
from storage.checkpoint_layout import robot_folder, robot_owner, robot_windows, round_folder

log = logging.getLogger(__name__)


class CheckpointedRobots:
    """Robots on the link that write their checkpoints before they upload, and go back to them.

    A checkpoint of every ``state.every`` windows is one that the server and all robots write; one
    at the end of a Flower round carries the robots over to the process that plays the next. Without
    a folder for them, ``state``, there are none.

    Attributes:
        parameters: P, of one network.
    """

    def __init__(self, config: Config, robots: Sequence[int], state: Path | None) -> None:
        self._config, self._state = config, state
        self._ended: tuple[int, bool] | None = None
        self._group = RobotGroup(config, robots)
        self.parameters = self._group.parameters
        self._writer = Writer()

    def step(self, step: Step) -> NDArray[np.int32] | None:
        """See ``Robots.step``."""
        actions = self._group.step(step)
        if step.expect is not Expect.ACTIONS:
            self._ended = (step.window, step.expect is Expect.END_ROUND)
        return actions

    def upload(self) -> Payload:
        """See ``Robots.upload``; a checkpoint that could not be written is an OSError."""
        sent = self._group.upload()  # before it is saved: a robot remembers what it has sent
        self._save()
        return sent

    def download(self, window: int, weights: Payload) -> None:
        """See ``Robots.download``."""
        self._group.download(window, weights)

    def windows(self) -> list[int]:
        """See ``Robots.windows``."""
        if self._state is None:
            return []
        self._save()
        self._writer.wait()
        robots = self._group.robots
        kept = (_whole_windows(self._state, robot, self._config.run.id) for robot in robots)
        return sorted(set.intersection(*kept))

    def begin(self, window: int, model: Payload | None) -> None:
        """See ``Robots.begin``.

        Raises:
            CheckpointError: the window's checkpoint is missing, damaged or another's.
            OSError: a checkpoint could not be written before.
        """
        self._writer.wait()
        self._ended = None
        self._group = RobotGroup(self._config, self._group.robots)
        if window:
            if self._state is None:
                raise CheckpointError(f"no checkpoint {window} was kept: state.every is null")
            load_state(self._group, self._state, window)
        if model is not None:
            self._group.download(window, model)

    def close(self) -> None:
        """Waits until all is on disk; an OSError where it cannot be written."""
        self._writer.close()

    def _save(self) -> None:
        """Writes the checkpoints of a window that has ended, where due or the last of a round."""
        if self._ended is None:
            return
        (window, last), self._ended = self._ended, None
        every = self._config.state.every
        due = every is not None and window % every == 0
        if self._state is None or not (due or last):
            return
        self._writer.wait()
        place = robot_folder if due else round_folder
        save_state(self._group, self._state, window, place, self._writer.save)
        if last:
            self._writer.wait()


def _whole_windows(state: Path, robot: int, run: str | None) -> set[int]:
    """The windows of which a robot has a checkpoint that is whole and its own."""
    whole = set()
    for window, folder in robot_windows(state, robot).items():
        try:
            load_checkpoint(folder, window, robot_owner(run, robot))
        except CheckpointError as error:
            log.warning("robot %d cannot go on from window %d: %s", robot, window, error)
        else:
            whole.add(window)
    return whole


def held_robots(state: Path, robots: int) -> list[int]:
    """The robots, of K, of which there is any checkpoint in a folder."""
    return [robot for robot in range(robots) if robot_windows(state, robot)]


def save_state(
    group: RobotGroup,
    state: Path,
    window: int,
    place: Callable[[Path, int], Path] = robot_folder,
    save: Callable[..., object] = save_checkpoint,
) -> None:
    """Writes each robot's checkpoint of a window: replay, moments, random state, weights.

    ``place`` says in which folder below ``state``; ``save`` may be a ``Writer``'s.
    """
    for index, robot in enumerate(group.robots):
        arrays = group.robot_state(index)
        save(place(state, robot), window, arrays, robot_owner(group.run, robot))


def load_state(group: RobotGroup, state: Path, window: int) -> None:
    """Restores each robot from its checkpoint of a window.

    Raises:
        CheckpointError: it is missing, damaged or another's.
    """
    for index, robot in enumerate(group.robots):
        folder = robot_windows(state, robot).get(window)
        if folder is None:
            raise CheckpointError(f"{robot_folder(state, robot)} holds no checkpoint {window}")
        arrays, _ = load_checkpoint(folder, window, robot_owner(group.run, robot))
        group.restore_robot(index, arrays)
