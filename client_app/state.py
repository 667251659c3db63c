"""A robot's state on disk: what it has learned from stays with it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agent import CheckpointError, Writer, load_checkpoint, save_checkpoint
from client_app.robots import RobotGroup
from conf.places import robot_folder, robot_windows, round_folder
from env.link import Step, Want


class Keeper:
    """Robots on the link that write their checkpoints before they answer.

    A checkpoint of every ``every`` windows is one that the server and all robots write; one at the
    end of a Flower round carries the robots over to the process that plays the next.

    Args:
        group: the robots.
        state: the folder of checkpoints on this machine.
        every: windows between checkpoints; None writes those of rounds alone.
    """

    def __init__(self, group: RobotGroup, state: Path, every: int | None) -> None:
        self._group, self._state, self._every = group, state, every
        self._writer = Writer()

    def step(self, step: Step) -> NDArray[np.int32] | None:
        """See ``Robots.step``."""
        actions = self._group.step(step)
        if step.want is not Want.ACTIONS:
            self.save(step.window, step.want is Want.FAREWELL)
        return actions

    def upload(self) -> NDArray[np.float32]:
        """See ``Robots.upload``."""
        return self._group.upload()

    def download(self, window: int, weights: NDArray[np.float32]) -> None:
        """See ``Robots.download``."""
        self._group.download(window, weights)

    def save(self, window: int, last: bool) -> None:
        """Writes the checkpoints of a window, where it is due or the last of a round.

        Raises:
            OSError: the ones before could not be written.
        """
        due = self._every is not None and window % self._every == 0
        if not due and not last:
            return
        self._writer.wait()
        place = robot_folder if due else round_folder
        save_state(self._group, self._state, window, place, self._writer.save)
        if last:
            self._writer.wait()

    def close(self) -> None:
        """Waits until all is on disk.

        Raises:
            OSError: it could not be written.
        """
        self._writer.close()


def save_state(
    group: RobotGroup,
    state: Path,
    window: int,
    place: Callable[[Path, int], Path] = robot_folder,
    save: Callable[..., object] = save_checkpoint,
) -> None:
    """Writes each robot's checkpoint of a window: replay, moments, random state, weights.

    Args:
        group: the robots.
        state: the folder of checkpoints on this machine.
        window: windows that have been played.
        place: the folder of a robot's checkpoints, below ``state``.
        save: ``agent.save_checkpoint``, or a writer's.
    """
    for index, robot in enumerate(group.robots):
        arrays = group.agents.agent_state(index)
        save(place(state, robot), window, arrays, {"robot": robot})


def load_state(group: RobotGroup, state: Path, window: int) -> None:
    """Restores each robot from its checkpoint of a window.

    Raises:
        CheckpointError: it is missing or damaged.
    """
    for index, robot in enumerate(group.robots):
        folder = robot_windows(state, robot).get(window)
        if folder is None:
            raise CheckpointError(f"{robot_folder(state, robot)} holds no checkpoint {window}")
        arrays, _ = load_checkpoint(folder, window)
        group.agents.restore_agent(index, arrays)
