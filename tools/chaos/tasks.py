"""The task of the chaos suite, and how it is played in each runtime."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from conf.schema import FederationConfig
from experiments.runtimes.runner import RUNTIMES
from repeatable import process_tracker

WATCHDOG = "watchdog"
ROLES = {**process_tracker.ROLES, WATCHDOG: r"experiments\.flower\.watchdog"}
"""Who may be killed, by command line."""

ROBOTS = 3
TICKS_PER_WINDOW = 25
WINDOWS_PER_CHECKPOINT = 2

TASK = (
    f"env.robots={ROBOTS}",
    "agent.hidden=[16,16]",
    "agent.replay_size=500",
    f"federation.every={TICKS_PER_WINDOW}",
    "train.episodes=1000000",
    f"state.every={WINDOWS_PER_CHECKPOINT}",
    "evaluation.every=4",
    "evaluation.episodes=2",
    "run.figures=false",
    "run.tensorboard=false",
)
"""The paper's task with small networks; a checkpoint every 50 ticks."""


@dataclasses.dataclass(frozen=True)
class Runtime:
    """How a runtime is killed and what it is given.

    Attributes:
        name: of the runtime.
        windows: windows that a run plays.
        windows_per_round: 0 where there are no Flower rounds.
        overrides: what the runtime adds to the task.
        roles: whom to kill, as far as they are there.
        starting_s: from the first process to a run folder that says `starting`.
        joining_s: from there to the first checkpoint.
        finishing_s: from the last window to the last process.
        ends_within_s: the longest time from a kill to the end of the launcher, where the run does
            not go on.
        gone_within_s: the longest time from there to the end of every other process.
        patience_s: the longest a whole process may take; it hangs after that.
        comes_back: roles that are started again when they die, so that the run goes on by itself
            once it has a checkpoint.
        moments: kinds of the moments at which to kill; none: all.
    """

    name: str
    windows: int
    windows_per_round: int
    overrides: tuple[str, ...]
    roles: tuple[str, ...]
    starting_s: float
    joining_s: float
    finishing_s: float
    ends_within_s: float
    gone_within_s: float
    patience_s: float
    comes_back: tuple[str, ...] = ()
    moments: tuple[str, ...] = ()

    def begin(self, folder: Path) -> list[str]:
        """Overrides of a new run in a folder."""
        length = f"train.max_ticks={self.windows * TICKS_PER_WINDOW}"
        return [*TASK, length, f"runtime={self.name}", *self.overrides, f"run.dir={folder}"]

    def missing(self) -> str:
        """What this version lacks to play it, empty if nothing."""
        if self.name not in RUNTIMES:
            return f"runtime={self.name} is no choice in this version"
        known = {field.name for field in dataclasses.fields(FederationConfig)}
        keys = [item.split("=")[0] for item in self.overrides]
        lacking = [
            key for key in keys if key.startswith("federation.") and key.split(".")[1] not in known
        ]
        return f"{lacking[0]} is no key in this version" if lacking else ""


WINDOWS = 80
ROUND = 20
_FLOWER = ("federation.clients=2", f"federation.windows_per_round={ROUND}")
_FLOWER_ROLES = ("launcher", "SuperLink", "SuperExec", "ClientApp", "watchdog")
_COME_BACK = ("SuperLink", "SuperExec", "ServerApp", "SuperNode", "ClientApp", "watchdog")

LOCAL = Runtime("local", WINDOWS, 0, (), ("launcher",), 4.0, 0.1, 0.3, 10.0, 5.0, 120.0)
SIMULATION = Runtime(
    "simulation", WINDOWS, ROUND, _FLOWER,
    (*_FLOWER_ROLES, "ServerApp (engine)", "raylet", "Ray GCS", "Ray agent", "Ray service"),
    14.0, 14.0, 4.0, 60.0, 30.0, 240.0,
)  # fmt: skip
DEPLOYMENT = Runtime(
    "deployment", WINDOWS, ROUND, (*_FLOWER, "federation.on_loss=wait"),
    (*_FLOWER_ROLES, "ServerApp", "SuperNode"),
    10.0, 20.0, 4.0, 120.0, 30.0, 600.0, _COME_BACK,
)  # fmt: skip
ALL = {runtime.name: runtime for runtime in (LOCAL, SIMULATION, DEPLOYMENT)}
