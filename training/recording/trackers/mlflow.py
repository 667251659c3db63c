"""MLflow: by default a database in the run's folder."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

from conf import Config
from training.recording.trackers.interface import results
from training.run_folder import RunFolder

EXPERIMENT = "risfleet"
TAG = "risfleet.run"
"""Holds the run's id, by which a run that goes on finds its record."""

MOST_AT_ONCE = 900
MOST_PARAMETERS = 100
"""What MLflow takes in one call: 1,000 values, or 100 parameters."""

LONGEST = 500
"""Characters of a parameter that every store of MLflow takes."""

PERIOD_S = 5.0
"""A call costs tens of milliseconds, so values wait for others, but no longer than this."""


class MLflow:
    """A run of MLflow; implements ``interface.Tracker``.

    MLflow's own variables count, ``MLFLOW_TRACKING_URI`` and ``MLFLOW_EXPERIMENT_NAME`` among
    them. Without the first nothing leaves this machine, MLflow's report of its use included.
    """

    name = "MLflow"

    def __init__(self, folder: RunFolder) -> None:
        self._folder = folder
        self._client: Any = None
        self._id: str | None = None
        self._waiting: list[Any] = []
        self._written = 0.0

    def start(self, config: Config) -> None:
        """See ``Tracker.start``."""
        os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")  # MLflow reads it nowhere else
        os.environ.setdefault("MLFLOW_LOGGING_LEVEL", "WARNING")
        from mlflow import MlflowClient  # slow: only where it is wanted

        uri = os.environ.get("MLFLOW_TRACKING_URI")
        if not uri:
            self._folder.mlflow.mkdir(parents=True, exist_ok=True)
            uri = f"sqlite:///{self._folder.mlflow.absolute()}/mlflow.db"
        self._client = MlflowClient(tracking_uri=uri)
        experiment = self._experiment(in_folder=uri != os.environ.get("MLFLOW_TRACKING_URI"))
        self._id = self._begun(experiment, config)
        self._written = time.monotonic()

    def log(self, step: int, scalars: Mapping[str, float]) -> None:
        """See ``Tracker.log``."""
        self._add(step, scalars)
        if len(self._waiting) > MOST_AT_ONCE // 2 or time.monotonic() - self._written > PERIOD_S:
            self._write()

    def finish(self, summary: Mapping[str, Any] | None) -> None:
        """See ``Tracker.finish``."""
        if self._id is None:
            return
        status = "FAILED" if summary is None else "FINISHED"
        if summary is not None:
            self._add(summary["ticks"], results(summary))
            for name, digest in summary["digest"].items():
                self._client.set_tag(self._id, f"risfleet.digest.{name}", digest)
        self._write()
        self._client.set_terminated(self._id, status)

    def _experiment(self, *, in_folder: bool) -> str:
        """The experiment's id; where it is made, what is kept of it lies in the run's folder."""
        name = os.environ.get("MLFLOW_EXPERIMENT_NAME", EXPERIMENT)
        found = self._client.get_experiment_by_name(name)
        if found is not None:
            return str(found.experiment_id)
        place = self._folder.mlflow.absolute().as_uri() if in_folder else None
        return str(self._client.create_experiment(name, artifact_location=place))

    def _begun(self, experiment: str, config: Config) -> str:
        """The id of the record that an earlier part of the run has begun, or of a new one."""
        from mlflow.entities import Param

        tags = {}
        if config.run.id is not None:
            tags = {TAG: config.run.id}
            wanted = f"tags.`{TAG}` = '{config.run.id}'"
            for run in self._client.search_runs([experiment], wanted, max_results=1):
                self._client.update_run(run.info.run_id, status="RUNNING")
                return str(run.info.run_id)
        made = self._client.create_run(experiment, run_name=self._folder.path.name, tags=tags)
        parameters = [Param(key, str(it)[:LONGEST]) for key, it in _flat(asdict(config))]
        for first in range(0, len(parameters), MOST_PARAMETERS):
            some = parameters[first : first + MOST_PARAMETERS]
            self._client.log_batch(made.info.run_id, params=some)
        return str(made.info.run_id)

    def _add(self, step: int, scalars: Mapping[str, float]) -> None:
        from mlflow.entities import Metric

        now_ms = int(time.time() * 1000)
        self._waiting += [Metric(name, it, now_ms, step) for name, it in scalars.items()]

    def _write(self) -> None:
        self._written = time.monotonic()
        while some := self._waiting[:MOST_AT_ONCE]:
            self._client.log_batch(self._id, metrics=some)
            del self._waiting[: len(some)]


def _flat(values: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Each value by its dotted key."""
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{above}{name}.")
        else:
            yield above + name, value
