"""Runs that have ended, as figures and tables read them."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conf import Config
from conf.rooms import room_name
from storage.checkpoint_files import digest
from training.recording.history import MEASURES
from training.run_folder import RunFolder

Columns = dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Run:
    """A run that has ended, by its folder."""

    folder: Path

    @property
    def files(self) -> RunFolder:
        """The folder's files."""
        return RunFolder(self.folder)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """What it came to."""
        return self.files.read_summary()

    @cached_property
    def config(self) -> Config:
        """What it was trained with."""
        return self.files.read_config()

    @property
    def seed(self) -> int:
        """Of its configuration."""
        return self.config.seed

    def metrics(self) -> Columns:
        """The columns of ``metrics.csv``, each of shape (episodes,)."""
        return _columns(self.files.metrics_file)

    def evaluations(self) -> Columns:
        """The columns of ``evaluations.csv`` with exploration, each of shape (evaluations,)."""
        return _columns(self.files.evaluations_file, 2)

    def weights(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Online weights: robots (K, P), access point (P_AP,).

        Raises:
            ConfigError: they are missing or damaged.
        """
        return self.files.read_weights(self.config)


@dataclass(frozen=True)
class HeldOutRoom(Run):
    """A held-out room of a building that has ended: its weights, and what they are worth there."""

    building: Run

    @classmethod
    def first(cls, building: Run) -> HeldOutRoom:
        """The first held-out room of a building."""
        return cls(building.files.room(room_name(0, held_out=True)).path, building)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The building's, with the digests of this room's weights.

        The evaluation is that of the final weights, a mean over all held-out rooms.
        """
        rows = _columns(self.building.files.rooms_log_file)
        last = (rows["held_out"] == 1) & (rows["round"] == rows["round"].max())
        kinds = {"eps05": last & (rows["epsilon"] > 0), "greedy": last & (rows["epsilon"] == 0)}
        evaluation = {
            kind: {name: float(np.nanmean(rows[name][chosen])) for name in MEASURES}
            for kind, chosen in kinds.items()
        }
        robots, ap = self.files.read_networks(self.config)
        digests = {"robots": digest(robots), "ap": digest(ap)}
        return {**self.building.summary, "digest": digests, "evaluation": evaluation}

    def evaluations(self) -> Columns:
        """Those of the building while it was trained."""
        return self.building.evaluations()


Runs = Mapping[str, Mapping[int, Run]]
"""From a cell's name and a seed to a run."""


def _columns(path: Path, step: int = 1) -> Columns:
    """The columns of a CSV file of numbers, of every ``step``-th row; empty is nan."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.DictReader(file)
        names, rows = reader.fieldnames or (), list(reader)[::step]
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in names}
