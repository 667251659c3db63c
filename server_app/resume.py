"""``resume=RUN``: a run that died or was stopped goes on from its last checkpoint."""

from __future__ import annotations

import dataclasses
import secrets
from collections.abc import Sequence
from pathlib import Path

from agent import CheckpointError
from conf import Config, ConfigError, compose, fingerprint, overridden, robots_learn
from conf.places import STATE
from server_app.checkpoint import Checkpoint, latest
from server_app.preflight import check, checked_yaml
from server_app.recorder import check_files

PREFIX = "resume="
MAY_CHANGE = ("train.episodes", "train.max_ticks")
"""What a resume may set: when the run ends. All else would make it another run."""


def new_id() -> str:
    """A fresh identity for a run, 16 hexadecimal digits."""
    return secrets.token_hex(8)


def asked(overrides: Sequence[str]) -> bool:
    """Whether overrides ask to resume a run."""
    return any(item.startswith(PREFIX) for item in overrides)


def read(overrides: Sequence[str]) -> tuple[Config, Checkpoint]:
    """The run that ``resume=RUN`` names, and where it goes on.

    Args:
        overrides: ``resume=RUN`` and, if the end is to be another, ``train.episodes`` or
            ``train.max_ticks``.

    Returns:
        Its configuration, ``run.dir`` being where the run is now, and its newest whole checkpoint.

    Raises:
        ConfigError: there is no such run or checkpoint, it is another version's, it has ended, or
            another key is set.
    """
    folder = _folder(overrides)
    rest = [item for item in overrides if not item.startswith(PREFIX)]
    for item in rest:
        if item.split("=")[0] not in MAY_CHANGE:
            raise ConfigError(
                f"{item}: allowed beside resume are {' and '.join(MAY_CHANGE)}: all else is the"
                " run's own."
            )
    config = _config(folder, rest)
    try:
        elsewhere = config.runtime.name == "deployment"  # the robots' are on their nodes
        kept = robots_learn(config) and not elsewhere
        checkpoint = latest(folder / STATE, config.env.robots if kept else 0, config.run.id)
        check_files(folder, checkpoint.meta["marks"])
    except CheckpointError as error:
        raise ConfigError(f"resume={folder}: {error}.") from error
    if checkpoint.meta["fingerprint"] != fingerprint(config.env):
        raise ConfigError(
            f"resume={folder}: allowed is a run of this version of RISFleet, torch and plug-ins on"
            " this type of CPU: with another it would not end in the same weights."
        )
    _check_unfinished(folder, config, checkpoint)
    return config, checkpoint


def _folder(overrides: Sequence[str]) -> Path:
    folder = Path(next(item for item in overrides if item.startswith(PREFIX))[len(PREFIX) :])
    if not (folder / "config.yaml").is_file():
        raise ConfigError(f"{PREFIX}{folder}: allowed is the folder of a run.")
    return folder.absolute()


def _config(folder: Path, overrides: Sequence[str]) -> Config:
    """The run's own configuration, with what is set anew."""
    compose(overrides)  # checks each of them by itself
    try:
        config = checked_yaml((folder / "config.yaml").read_text())
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{PREFIX}{folder}: config.yaml cannot be read: {error}.") from error
    config = overridden(config, overrides)
    return check(dataclasses.replace(config, run=dataclasses.replace(config.run, dir=str(folder))))


def _check_unfinished(folder: Path, config: Config, checkpoint: Checkpoint) -> None:
    tick, _, episodes = (int(count) for count in checkpoint.arrays["run/progress"])
    most = config.train.max_ticks
    if not all((folder / name).exists() for name in ("summary.json", "weights.safetensors")):
        return  # it died after its last window: the rest is still to be written
    if episodes >= config.train.episodes or (most is not None and tick >= most):
        raise ConfigError(
            f"{PREFIX}{folder}: the run has ended, with {episodes} episodes and {tick} ticks:"
            " allowed is one that has not, or a larger train.episodes or train.max_ticks."
        )
