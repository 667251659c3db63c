"""What each file of a run's folder is called, and what it is for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class RunPaths:
    """Where everything of a run is; no other module knows the name of a file in it.

    Attributes:
        path: the folder.
    """

    path: Path

    def __str__(self) -> str:
        """The folder's path."""
        return str(self.path)

    @property
    def config_file(self) -> Path:
        """The whole configuration."""
        return self.path / "config.yaml"

    @property
    def summary_file(self) -> Path:
        """What the run came to; written last but for the figures."""
        return self.path / "summary.json"

    @property
    def progress_file(self) -> Path:
        """How far the run has come, for whoever watches from outside."""
        return self.path / "progress.json"

    @property
    def metrics_file(self) -> Path:
        """An episode a row."""
        return self.path / "metrics.csv"

    @property
    def evaluations_file(self) -> Path:
        """An evaluation two rows: with exploration, then greedy."""
        return self.path / "evaluations.csv"

    @property
    def episode_file(self) -> Path:
        """The newest episode of an evaluation, slot by slot, for whoever watches."""
        return self.path / "episode.json"

    @property
    def rooms_file(self) -> Path:
        """The rooms of a building, as ``conf.rooms`` describes them."""
        return self.path / "rooms.json"

    @property
    def rooms_log_file(self) -> Path:
        """Evaluations of a building, two rows for each room: with exploration, then greedy."""
        return self.path / "rooms.csv"

    @property
    def weights_file(self) -> Path:
        """The final weights."""
        return self.path / "weights.safetensors"

    @property
    def stop_file(self) -> Path:
        """Once it is there, the run ends at its next window boundary; of a sweep, all its runs."""
        return self.path / "stop"

    @property
    def log_file(self) -> Path:
        """What Flower's processes say."""
        return self.path / "flower.log"

    @property
    def state(self) -> Path:
        """The folder of checkpoints, see ``storage.checkpoint_layout``."""
        return self.path / "state"

    @property
    def figures(self) -> Path:
        """The folder of figures."""
        return self.path / "figures"

    @property
    def tensorboard(self) -> Path:
        """The folder of TensorBoard's events."""
        return self.path / "tensorboard"

    @property
    def wandb(self) -> Path:
        """The folder that W&B makes for itself."""
        return self.path / "wandb"

    @property
    def mlflow(self) -> Path:
        """The folder of MLflow's database, unless the user names another."""
        return self.path / "mlflow"
