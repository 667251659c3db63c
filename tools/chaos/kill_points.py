"""When a process is to die, told by what the run has written rather than by a clock."""

from __future__ import annotations

import json
import random
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from storage.checkpoint_files import checkpoints
from storage.checkpoint_layout import robot_windows, server_folder
from tools.chaos.tasks import WINDOWS_PER_CHECKPOINT, Runtime
from training.run_folder import RunFolder

STARTING = "start-up"
JOINING = "first windows"
MIDDLE = "mid-window"
WRITING = "writing a checkpoint"
ROUND = "end of a round"
FINISHING = "end of the run"

MIDDLE_S = 0.15
"""About two windows of the task in one process."""


@dataclass(frozen=True)
class KillPoint:
    """A kill comes ``delay_s`` after the run's folder shows what ``kind`` and ``window`` say."""

    kind: str
    window: int = 0
    delay_s: float = 0.0


class Watched:
    """What a run's folder shows of the process that works in it now.

    Args:
        folder: the run's folder; it may hold what earlier processes left.
        robots: K.
        since: when this process was started, in s since the epoch.
    """

    def __init__(self, folder: Path, robots: int, since: float) -> None:
        self._folder, self._robots, self._since = folder, robots, since
        self.state = RunFolder(folder).state

    def reached(self, moment: KillPoint) -> bool:
        """Whether the folder shows that the moment is there, its delay aside."""
        if moment.kind == STARTING:
            return True
        if moment.kind == JOINING:
            return bool(self.says())
        if moment.kind == FINISHING:
            return self.says() in ("finishing", "done")
        if moment.kind == ROUND:
            return any(
                max(robot_windows(self.state, robot), default=0) >= moment.window
                for robot in range(self._robots)
            )
        return self.checkpoint() >= moment.window

    def says(self) -> str:
        """The state in ``progress.json``, empty where this process has written none yet."""
        status = read_json(self._folder / "progress.json")
        fresh = float(status.get("written_at", 0.0)) >= self._since
        return str(status["state"]) if fresh else ""

    def checkpoint(self) -> int:
        """The newest window that the server has a checkpoint of, 0 if none."""
        return max(checkpoints(server_folder(self.state)), default=0)

    def is_writing(self) -> bool:
        """Whether a checkpoint is half written at this instant."""
        for path in self.state.glob("**/*.writing"):
            try:
                if path.stat().st_mtime >= self._since:
                    return True
            except OSError:
                pass  # it has just been renamed
        return False


def newest(state: Path, robots: int) -> int:
    """The newest window that anyone has a checkpoint of, 0 if none."""
    places = [robot_windows(state, robot) for robot in range(robots)]
    return max(checkpoints(server_folder(state)) + [w for place in places for w in place] + [0])


def draw(rng: random.Random, runtime: Runtime, first: int) -> KillPoint:
    """A random moment of a run that goes on after a window.

    Args:
        rng: of the suite.
        runtime: how long its phases take, and its rounds.
        first: the newest window that is on disk already, see `newest`; 0 for a new run.
    """
    last, rounds = runtime.windows, runtime.windows_per_round
    ends = range(first - first % rounds + rounds, last, rounds) if rounds else range(0)
    inside = range(first + WINDOWS_PER_CHECKPOINT, last - WINDOWS_PER_CHECKPOINT)
    kinds = [STARTING, JOINING, FINISHING]
    kinds += [MIDDLE, MIDDLE, WRITING, WRITING] if inside else []
    kinds += [ROUND, ROUND] if ends else []
    kind = rng.choice([kind for kind in kinds if kind in runtime.moments] or kinds)
    if kind == STARTING:
        return KillPoint(kind, delay_s=rng.uniform(0, runtime.starting_s))
    if kind == JOINING:
        return KillPoint(kind, delay_s=rng.uniform(0, runtime.joining_s))
    if kind == FINISHING:
        return KillPoint(kind, delay_s=rng.uniform(0, runtime.finishing_s))
    if kind == ROUND:
        return KillPoint(kind, rng.choice(ends), rng.uniform(0, 2 * MIDDLE_S))
    delay_s = 0.0 if kind == WRITING else rng.uniform(0, MIDDLE_S)
    return KillPoint(kind, rng.choice(inside), delay_s)


def read_json(path: Path) -> dict[str, Any]:
    """A JSON file's object, empty where there is none yet."""
    try:
        content: dict[str, Any] = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return content
