"""``resume=RUN``: a run that died or was stopped goes on from its last checkpoint."""

from __future__ import annotations

import dataclasses
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from conf import (
    Config,
    ConfigError,
    fingerprint,
    flower_clients,
    from_yaml,
    has_rooms,
    overridden,
    robots_learn,
    to_yaml,
)
from conf.overrides import parse
from conf.user_paths import RESUME, pasted, resumed_folder
from env.texts import read_text
from storage.checkpoint_files import CheckpointError
from training.checkpoint import Checkpoint, latest
from training.preflight import check, check_strategies, check_trackers
from training.recording.csv_log import check_files
from training.recording.progress import Progress
from training.run_folder import RunFolder

MAY_CHANGE = ("train.episodes", "train.max_ticks")
"""What a resume may set: when the run ends. All else would make it another run."""


def identified(config: Config, folder: Path) -> Config:
    """A configuration that says where its run is, and names it, if it has no name yet."""
    identity = config.run.id or secrets.token_hex(8)
    run = dataclasses.replace(config.run, dir=str(folder), id=identity)
    return dataclasses.replace(config, run=run)


def asked(overrides: Sequence[str]) -> bool:
    """Whether overrides ask to resume a run."""
    return any(resumed_folder(item) is not None for item in overrides)


def how(folder: Path) -> str:
    """The command that goes on with a run, as it can be pasted into a shell."""
    return f"risfleet train {pasted(RESUME, folder)}"


def read(overrides: Sequence[str]) -> tuple[Config, Checkpoint]:
    """The run that ``resume=RUN`` names, and where it goes on.

    Args:
        overrides: ``resume=RUN`` and, if the end is to be another, ``train.episodes`` or
            ``train.max_ticks``.

    Returns:
        Its configuration, ``run.dir`` being where the run is now, and its newest whole checkpoint.

    Raises:
        ConfigError: there is no such run or checkpoint, it is another version's, it has ended,
            another key is set, or a tracker of it is not installed.
    """
    folder = _folder(overrides)
    rest = [item for item in overrides if resumed_folder(item) is None]
    for item in parse(rest):
        if item.key_or_group not in MAY_CHANGE:
            raise ConfigError(
                f"{item.input_line}: allowed beside resume are {' and '.join(MAY_CHANGE)}: all else"
                " is the run's own."
            )
    config = _config(folder, rest)
    check_trackers(config)
    check_strategies(config)
    try:
        checkpoint = _checkpoint(folder, config)
    except CheckpointError as error:
        raise ConfigError(f"resume={folder}: {error}.") from error
    progress = checkpoint.progress
    if folder.has_ended and progress.reaches(config.train):
        raise ConfigError(
            f"resume={folder}: the run has ended, with {progress.episodes} episodes and"
            f" {progress.tick} ticks: allowed is one that has not, or a larger train.episodes or"
            " train.max_ticks."
        )
    return config, checkpoint


def find_run_state(config: Config, folder: RunFolder) -> dict[str, Any] | Checkpoint | None:
    """How far a run has come that is wanted whole.

    Args:
        config: the run's configuration. ``train.episodes`` and ``train.max_ticks`` may differ from
            those in the folder, where the run began.
        folder: its folder, there or not.

    Returns:
        What ``summary.json`` holds if it has ended; otherwise its newest whole checkpoint; None
        if it has neither and begins.

    Raises:
        ConfigError: the folder holds something else, or a checkpoint of another version.
    """
    if not folder.has_begun:
        return None
    own = _config(folder, []) if folder.config_file.exists() else None
    if own is None or not same(own, config, until=False):
        raise ConfigError.of([("run.dir", folder, "a folder that is new, empty or of this run")])
    found: dict[str, Any] | Checkpoint | None = _ended(config, folder) if folder.has_ended else None
    over = found is not None
    if found is None:
        try:
            checkpoint = _checkpoint(folder, own)
        except CheckpointError as error:
            if folder.has_ended:
                allowed = f"a folder whose run has a checkpoint to go on from ({error})"
                raise ConfigError.of([("run.dir", folder, allowed)]) from error
            return None
        found, over = checkpoint, checkpoint.progress.reaches(config.train)
    if over and own.train != config.train:
        raise ConfigError.of([("run.dir", folder, "a folder whose run has not gone beyond this")])
    return found


def _ended(config: Config, folder: RunFolder) -> dict[str, Any] | None:
    """What ``summary.json`` holds if the run has come to its end."""
    try:
        summary = folder.read_summary()
        progress = Progress(summary["ticks"], episodes=summary["episodes"])
        return summary if progress.reaches(config.train) else None
    except (LookupError, TypeError, ValueError) as error:
        allowed = f"a folder whose {folder.summary_file.name} is whole"
        raise ConfigError.of([("run.dir", folder, allowed)]) from error


def same(one: Config, other: Config, *, until: bool = True) -> bool:
    """Whether two configurations are of one run, wherever its folder and its robots lie.

    With ``until`` the run must end alike, too.
    """
    return _essence(one) == _essence(other) and (not until or one.train == other.train)


def _essence(config: Config) -> str:
    """A configuration as text, without what may differ from one part of a run to the next."""
    run = dataclasses.replace(config.run, dir=None, id=None)
    train = dataclasses.replace(config.train, episodes=1, max_ticks=None)
    federation = dataclasses.replace(config.federation, clients=flower_clients(config))
    return to_yaml(dataclasses.replace(config, run=run, train=train, federation=federation))


def _checkpoint(folder: RunFolder, config: Config) -> Checkpoint:
    """The newest whole checkpoint of a run; a ``ConfigError`` if it is another version's."""
    elsewhere = config.runtime.name == "deployment"  # the robots' are on their nodes
    robots = 0 if elsewhere else kept_robots(config)
    rooms = has_rooms(config) and config.runtime.connection is None
    checkpoint = latest(folder.state, robots, config.run.id, rooms=rooms)
    check_files(folder, checkpoint.meta["marks"])
    if checkpoint.meta["fingerprint"] != fingerprint(config.env):
        raise ConfigError(
            f"resume={folder}: allowed is a run of this version of RISFleet, torch and plug-ins on"
            " this type of CPU: with another it would not end in the same weights."
        )
    return checkpoint


def kept_robots(config: Config) -> int:
    """The robots that keep checkpoints of their own: none in a building, whose rooms do."""
    return config.env.robots if robots_learn(config) and not has_rooms(config) else 0


def _folder(overrides: Sequence[str]) -> RunFolder:
    folders = [folder for item in overrides if (folder := resumed_folder(item)) is not None]
    if len(folders) > 1:
        raise ConfigError(f"resume={folders[1]}: allowed is one run to go on with.")
    if not RunFolder(folders[0]).config_file.is_file():
        raise ConfigError(f"resume={folders[0]}: allowed is the folder of a run.")
    return RunFolder(folders[0].absolute())


def _config(folder: RunFolder, overrides: Sequence[str]) -> Config:
    """The run's own configuration, with what is set anew."""
    try:
        config = from_yaml(read_text(folder.config_file))
    except (OSError, UnicodeError) as error:
        name = folder.config_file.name
        raise ConfigError(f"resume={folder}: {name} cannot be read: {error}.") from error
    config = overridden(config, overrides)
    return check(dataclasses.replace(config, run=dataclasses.replace(config.run, dir=str(folder))))
