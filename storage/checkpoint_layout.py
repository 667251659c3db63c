"""Where the checkpoints of a run lie, for every side that writes or reads one."""

from __future__ import annotations

from pathlib import Path

from storage.checkpoint_files import Json, checkpoints


def server_folder(state: Path) -> Path:
    """The server's checkpoints."""
    return state / "server"


def node_folder(states: Path, run: str) -> Path:
    """The checkpoints of one run on a node that keeps those of all its runs in one folder."""
    return states / run


def robot_folder(state: Path, robot: int) -> Path:
    """One robot's checkpoints, written when the server writes its own."""
    return state / f"robot-{robot:02d}"


def round_folder(state: Path, robot: int) -> Path:
    """One robot's checkpoints from the end of a Flower round to the next, and of a run's end."""
    return robot_folder(state, robot) / "round"


def robot_windows(state: Path, robot: int) -> dict[int, Path]:
    """The windows of which a robot has a checkpoint, and the folder of each."""
    folders = (round_folder(state, robot), robot_folder(state, robot))
    return {window: folder for folder in folders for window in checkpoints(folder)}


def owner(run: str | None) -> dict[str, Json]:
    """What a checkpoint's metadata say of its run's identity, which may be None."""
    return {} if run is None else {"run": run}


def robot_owner(run: str | None, robot: int) -> dict[str, Json]:
    """The same of a robot's checkpoint."""
    return {**owner(run), "robot": robot}


def room_folder(state: Path, room: str) -> Path:
    """The checkpoints of one room of a building, its access point's and robots' in one file."""
    return state / "rooms" / room


def room_owner(run: str | None, room: str) -> dict[str, Json]:
    """The same of a room's checkpoint."""
    return {**owner(run), "room": room}
