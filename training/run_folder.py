"""The folder of a run: what its files are called, and how each is read and written whole."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from conf import Config, ConfigError, from_yaml, to_yaml, weight_shapes
from env.texts import read_text
from storage.atomic import write_atomically, write_whole
from storage.safetensors_metadata import read_metadata, with_metadata
from storage.strict_json import to_json
from training.weights_metadata import config_in, describe

_NOTHING_YET: dict[str, Any] = {
    "state": "unknown",
    "message": "",
    "written_at": None,
    "tick": 0,
    "window": 0,
    "episode": 0,
    "episodes": 1,
    "max_ticks": None,
    "steps_per_s": 0.0,
    "slots": None,
    "reward": None,
    "ee": None,
    "success": None,
    "evaluated": None,
}
"""What a run that failed before its first tick could not say, and a damaged file does not."""


class RunFolder:
    """A run's folder, there or not; no other module knows the name of a file in it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.config_file = path / "config.yaml"  # the whole configuration
        self.summary_file = path / "summary.json"  # what it came to; last but for the figures
        self.progress_file = path / "progress.json"  # how far it is, for whoever watches
        self.metrics_file = path / "metrics.csv"  # an episode a row
        self.evaluations_file = path / "evaluations.csv"  # two rows each: explored, then greedy
        self.episode_file = path / "episode.json"  # the newest of an evaluation, slot by slot
        self.rooms_file = path / "rooms.json"  # of a building, as ``conf.rooms`` describes them
        self.rooms_log_file = path / "rooms.csv"  # two rows for each room that is evaluated
        self.weights_file = path / "weights.safetensors"  # the final ones
        self.stop_file = path / "stop"  # with it the run, or all of a sweep, ends at a window's end
        self.log_file = path / "flower.log"  # what Flower's processes say
        self.state = path / "state"  # checkpoints, see ``storage.checkpoint_layout``
        self.figures = path / "figures"
        self.tensorboard = path / "tensorboard"  # its events
        self.wandb = path / "wandb"  # which W&B makes for itself
        self.mlflow = path / "mlflow"  # MLflow's database, unless the user names another

    def __str__(self) -> str:
        """The folder's path."""
        return str(self.path)

    @classmethod
    def of(cls, config: Config) -> RunFolder:
        """The folder that a configuration names in ``run.dir``."""
        return cls(Path(str(config.run.dir)))

    @classmethod
    def named(cls, path: Path) -> RunFolder:
        """The folder of that path, or the one that holds the file of weights of that path."""
        within = cls(path.parent)
        return within if within.weights_file == path else cls(path)

    def room(self, name: str) -> RunFolder:
        """The folder of a room, which is that of a run: its configuration and final weights."""
        return RunFolder(self.path / "rooms" / name)

    # --- What is there ----------------------------------------------------------------------------

    @property
    def has_begun(self) -> bool:
        """Whether it holds more than what a run leaves that did not get to its configuration."""
        before = {self.progress_file, self.stop_file}
        return self.path.is_dir() and not {*self.path.iterdir()} <= before

    @property
    def has_ended(self) -> bool:
        """Whether what a run writes at its end is there."""
        weights = self.weights_file.is_file() or self.rooms_file.is_file()  # else rooms have them
        return self.summary_file.is_file() and weights

    @property
    def has_records(self) -> bool:
        """Whether what a run writes as it goes is there."""
        return self.metrics_file.is_file() and self.evaluations_file.is_file()

    def results(self) -> list[Path]:
        """What is there for the user to look at, sorted."""
        files = [self.config_file, self.summary_file, self.weights_file, *self._records]
        found = (*files, *self._tracked, *self.figures.glob("*.png"))
        return sorted(path for path in found if path.exists())

    @property
    def _records(self) -> list[Path]:
        return [self.metrics_file, self.evaluations_file, self.rooms_log_file]

    @property
    def _tracked(self) -> list[Path]:
        return [self.tensorboard, self.wandb, self.mlflow]

    def clear(self, *, whole: bool = False) -> None:
        """Removes what a run that goes on says anew; the ``whole`` of it where one begins again."""
        stale = [self.progress_file, self.summary_file, self.episode_file]
        for path in stale + (self._records if whole else []):
            path.unlink(missing_ok=True)
        for folder in self._tracked if whole else []:
            shutil.rmtree(folder, ignore_errors=True)

    # --- Configuration, summary, weights ----------------------------------------------------------

    def read_config(self) -> Config:
        """The configuration that the run has written; without its file, that in its weights.

        Raises:
            ConfigError: it is not there, or wrong.
        """
        path = self.config_file
        try:
            if not path.exists() and (found := config_in(read_metadata(self.weights_file))):
                return found
            return from_yaml(read_text(path))
        except UnicodeError as error:
            raise ConfigError(f"{path} cannot be read: {error}.") from error
        except OSError as error:
            raise ConfigError(f"{self} is no run folder: {path.name} cannot be read.") from error

    def write_config(self, config: Config) -> None:
        """Writes the configuration."""
        write_atomically(self.config_file, to_yaml(config))

    def read_summary(self) -> dict[str, Any]:
        """What the run came to.

        Raises:
            OSError: it cannot be read; ``FileNotFoundError`` before the run's end.
            ValueError: it is damaged.
        """
        found: dict[str, Any] = json.loads(self.summary_file.read_text(encoding="utf-8-sig"))
        return found

    def write_summary(self, summary: dict[str, Any]) -> None:
        """Writes what the run came to."""
        write_atomically(self.summary_file, to_json(summary))

    def read_weights(self, config: Config) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The online ones of ``read_networks``: robots (K, P) and access point (P_AP,)."""
        robots, ap = self.read_networks(config)
        return robots[:, 0], ap[0]

    def read_networks(self, config: Config) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """All weights that the run has written, online then target: (K, 2, P) and (2, P_AP).

        Raises:
            ConfigError: they are missing, damaged or of another size than the configuration's.
        """
        path = self.weights_file
        try:
            arrays = load_file(path)
        except FileNotFoundError as error:
            raise ConfigError(f"{path} is missing: has the run ended?") from error
        except SafetensorError as error:
            raise ConfigError(f"{path} is damaged: {error}.") from error
        except OSError as error:
            raise ConfigError(f"{path} cannot be read: {error.strerror or error}.") from error
        for name, shape in weight_shapes(config).items():
            if name not in arrays or arrays[name].shape != shape:
                found = arrays[name].shape if name in arrays else "nothing"
                own = self.config_file.name
                raise ConfigError(f"{path}: {name} is {found} where {own} says {shape}.")
        return arrays["robots"], arrays["ap"]

    def write_weights(
        self, robots: NDArray[np.float32], ap: NDArray[np.float32], config: Config
    ) -> None:
        """Writes the final weights as ``read_networks`` gives them, and what they are."""
        arrays = {"robots": np.ascontiguousarray(robots), "ap": np.ascontiguousarray(ap)}
        content = with_metadata(save(arrays), describe(config, robots, ap))
        write_whole(self.weights_file, content)

    # --- Progress ---------------------------------------------------------------------------------

    def read_progress(self) -> dict[str, Any] | None:
        """What the run last said of its progress; None if it has said nothing yet."""
        written = _read_object(self.progress_file)
        return None if written is None else _NOTHING_YET | written

    def write_progress(self, status: Mapping[str, Any]) -> None:
        """Writes how far the run has come; a crash of the machine may undo it."""
        write_atomically(self.progress_file, json.dumps(status), durable=False)

    def read_episode(self) -> dict[str, Any] | None:
        """The newest recorded episode, as ``training.trace.recorded``; None if there is none."""
        return _read_object(self.episode_file)

    def write_episode(self, episode: Mapping[str, Any]) -> None:
        """Writes the newest episode; a crash of the machine may undo it."""
        self.path.mkdir(parents=True, exist_ok=True)
        write_atomically(self.episode_file, json.dumps(episode), durable=False)

    def report_failure(self, error: BaseException) -> None:
        """Writes to the progress that the run failed, and why; a first failure stands."""
        with suppress(OSError):  # of a full disk: the error that stands is the first
            self.report_state("failed", f"{type(error).__name__}: {error}")

    def report_state(self, state: str, message: str) -> None:
        """Writes to the progress what has become of the run; a failure stands.

        Raises:
            OSError: the file cannot be written.
        """
        status = _read_object(self.progress_file) or {}
        if status.get("state") == "failed":
            return
        status |= {"state": state, "message": message, "written_at": time.time()}
        self.path.mkdir(parents=True, exist_ok=True)
        write_atomically(self.progress_file, json.dumps(status))

    @property
    def failure(self) -> str | None:
        """Why the run failed, in its own words; None if it says no such thing."""
        status = self.read_progress()
        return str(status["message"]) if status and status["state"] == "failed" else None


def _read_object(path: Path) -> dict[str, Any] | None:
    """What a file of JSON holds; None if it is not yet there, or damaged."""
    try:
        found = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None
