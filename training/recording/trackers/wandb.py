"""Weights & Biases: by default offline, into the run's folder, for ``wandb sync`` later on."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from conf import Config
from training.recording.trackers.interface import results
from training.run_folder import RunFolder

PROJECT = "risfleet"
SERVICE = "WANDB_SERVICE"
"""The variable in which W&B says how to reach its helper process."""


class WandB:
    """A run of Weights & Biases, whose id is the run's; implements ``interface.Tracker``.

    W&B's own variables count, ``WANDB_MODE`` and ``WANDB_PROJECT`` among them. Without the first
    nothing leaves this machine, W&B's reports of its own errors included.
    """

    name = "W&B"

    def __init__(self, folder: RunFolder) -> None:
        self._folder = folder
        self._run: Any = None
        self._is_ours = False

    def start(self, config: Config) -> None:
        """See ``Tracker.start``."""
        os.environ.setdefault("WANDB_ERROR_REPORTING", "false")  # W&B reads it nowhere else
        import wandb  # slow: only where it is wanted

        self._is_ours = SERVICE not in os.environ  # else a user's script has begun with W&B
        hook = sys.excepthook
        try:
            self._run = wandb.init(
                project=os.environ.get("WANDB_PROJECT", PROJECT),
                name=os.environ.get("WANDB_NAME", self._folder.path.name),
                id=config.run.id,
                resume="allow",
                dir=str(self._folder.path),
                mode=os.environ.get("WANDB_MODE", "offline"),
                config=asdict(config),
                allow_val_change=True,
                reinit="create_new",
                settings=wandb.Settings(
                    console="off",  # the run's own display stays as it is
                    silent=True,
                    disable_code=True,
                    disable_git=True,
                    x_disable_stats=True,
                ),
            )
        finally:
            sys.excepthook = hook
        self._run.define_metric("*", step_metric="tick")

    def log(self, step: int, scalars: Mapping[str, float]) -> None:
        """See ``Tracker.log``."""
        self._run.log({"tick": step, **scalars})

    def finish(self, summary: Mapping[str, Any] | None) -> None:
        """See ``Tracker.finish``."""
        try:
            if self._run is not None:
                if summary is not None:
                    digests = {f"digest/{name}": it for name, it in summary["digest"].items()}
                    self._run.summary.update({**results(summary), **digests})
                self._run.finish(exit_code=int(summary is None))
        finally:
            if self._is_ours:
                _end_helper()


def _end_helper() -> None:
    """Ends the process that W&B has started, which it would leave to the end of this one."""
    import wandb

    wandb.teardown()
    os.environ.pop(SERVICE, None)
