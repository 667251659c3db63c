"""The trackers that a run has chosen, as one; a run never ends because of them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from conf import Config, version
from conf.schema import RunConfig
from env.validate import Problem
from training.recording.trackers.interface import Tracker
from training.recording.trackers.mlflow import MLflow
from training.recording.trackers.tensorboard import TensorBoard
from training.recording.trackers.wandb import WandB
from training.run_folder import RunFolder

DISTRIBUTIONS = {"wandb": ("wandb",), "mlflow": ("mlflow-skinny", "mlflow")}
"""By key of ``run`` and name of the extra: any of these has what it takes."""

log = logging.getLogger(__name__)


class Trackers:
    """Trackers of a run, told in order. One that fails is given up with a warning."""

    def __init__(self, trackers: Sequence[Tracker]) -> None:
        self._open = list(trackers)

    @classmethod
    def of(cls, config: Config, folder: RunFolder, undone: int) -> Trackers:
        """Those that a run has chosen; what it has recorded from ``undone`` on comes again."""
        chosen: list[Tracker] = []
        if config.run.tensorboard:
            chosen.append(TensorBoard(folder.tensorboard, undone))
        if config.run.wandb:
            chosen.append(WandB(folder))
        if config.run.mlflow:
            chosen.append(MLflow(folder))
        return cls(chosen)

    def start(self, config: Config) -> None:
        """See ``Tracker.start``."""
        self._each(lambda tracker: tracker.start(config))

    def log(self, step: int, scalars: Mapping[str, float]) -> None:
        """See ``Tracker.log``."""
        self._each(lambda tracker: tracker.log(step, scalars))

    def finish(self, summary: Mapping[str, Any] | None = None) -> None:
        """See ``Tracker.finish``; safe to call again."""
        self._each(lambda tracker: tracker.finish(summary), last=True)
        self._open = []

    def _each(self, call: Callable[[Tracker], None], *, last: bool = False) -> None:
        for tracker in [*self._open]:
            try:
                call(tracker)
            except Exception as error:
                self._open.remove(tracker)
                why = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
                log.warning("no events for %s from here on: %s", tracker.name, why)
                if not last:
                    with suppress(Exception):  # the first failure has been told
                        tracker.finish(None)


def problems(run: RunConfig) -> list[Problem]:
    """Trackers that are asked for and not installed: keys, values, and what is allowed."""
    return [
        (f"run.{key}", True, f"false until it is installed: pip install 'risfleet[{key}]'")
        for key, names in DISTRIBUTIONS.items()
        if getattr(run, key) and all(version(name) == "unknown" for name in names)
    ]
