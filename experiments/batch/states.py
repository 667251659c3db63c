"""What the folder of a run holds that is wanted whole, and what the run costs."""

from __future__ import annotations

from enum import Enum
from pathlib import Path

from conf import Config, ConfigError, fingerprint, has_rooms
from training import resume
from training.checkpoint import Checkpoint
from training.rooms import known_rooms
from training.run_folder import RunFolder

TICKS_PER_EPISODE = 85
MS_PER_TICK_AND_ROBOT = 0.5
WORLDS_AS_DEAR = 16
"""Further copies of the world that cost as much again."""

COST = {"federated": 1.0, "branching": 0.65, "centralized": 4.0}
"""Processor time of a tick against F-DRL's (docs/baselines.md): which runs are long, no more."""


class State(Enum):
    """What a run's folder holds."""

    DONE = "done"
    BEGUN = "begun"  # a checkpoint, from which it goes on
    NEW = "new"  # nothing, or nothing that can be used


def folder_of(config: Config) -> Path:
    """A run's folder."""
    return RunFolder.of(config).path


def cost_s(config: Config) -> float:
    """A rough guess of a run's processor time in s."""
    worlds = config.train.worlds
    ticks = config.train.episodes * TICKS_PER_EPISODE / worlds
    ticks = min(ticks, config.train.max_ticks or ticks)
    each_ms = MS_PER_TICK_AND_ROBOT * config.env.robots * COST[config.scheme.agents]
    each_ms *= 1 + (worlds - 1) / WORLDS_AS_DEAR
    return ticks * each_ms * config.rooms.count / 1000


def state_of(config: Config) -> State:
    """What the folder of a run holds; what cannot be used counts as nothing."""
    if _is_done(config):
        return State.DONE
    try:
        found = resume.find_run_state(config, RunFolder.of(config))
    except (LookupError, OSError, ValueError):
        return State.NEW
    return State.BEGUN if isinstance(found, Checkpoint) else State.NEW


def check_folder(config: Config) -> None:
    """Checks that the folder of a run holds nothing, or this run.

    Raises:
        ConfigError: it holds something else, or the run of another version.
    """
    found = resume.find_run_state(config, RunFolder.of(config))
    if isinstance(found, dict) and not _is_done(config):
        allowed = "a folder whose run is whole and of this version of RISFleet"
        raise ConfigError.of([("run.dir", folder_of(config), allowed)])


def _is_done(config: Config) -> bool:
    """Whether a run has ended as it was meant to, and its files can be read."""
    folder = RunFolder.of(config)
    try:
        summary = folder.read_summary()
        whole = not summary["stopped_early"] and summary["fingerprint"] == fingerprint(config.env)
        if not whole or not resume.same(folder.read_config(), config):
            return False
        if has_rooms(config):
            for room in known_rooms(config, folder):
                folder.room(room.name).read_weights(room.config(config))
        else:
            folder.read_weights(config)
    except (LookupError, TypeError, ValueError, OSError):
        return False
    return folder.has_records
