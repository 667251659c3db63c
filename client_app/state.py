"""A robot's state on disk: what it has learned from stays with it."""

from __future__ import annotations

from pathlib import Path

from agent import load_checkpoint, save_checkpoint
from client_app.robots import RobotGroup


def robot_folder(folder: Path, robot: int) -> Path:
    """The folder of one robot's checkpoints."""
    return folder / f"robot-{robot:02d}"


def save_state(group: RobotGroup, folder: Path, window: int) -> None:
    """Writes each robot's checkpoint of a window: replay, moments, random state, weights."""
    for index, robot in enumerate(group.robots):
        arrays = group.agents.agent_state(index)
        save_checkpoint(robot_folder(folder, robot), window, arrays, {"robot": robot})


def load_state(group: RobotGroup, folder: Path, window: int) -> None:
    """Restores each robot from its checkpoint of a window.

    Raises:
        CheckpointError: it is missing or damaged.
    """
    for index, robot in enumerate(group.robots):
        arrays, _ = load_checkpoint(robot_folder(folder, robot), window)
        group.agents.restore_agent(index, arrays)
