"""TensorBoard: a file of events in the run's folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from conf import Config


class TensorBoard:
    """Writes events; implements ``interface.Tracker``.

    What an earlier part of the run has written from the tick ``undone`` on no longer counts.
    """

    name = "TensorBoard"

    def __init__(self, folder: Path, undone: int) -> None:
        self._folder, self._undone = folder, undone
        self._writer: Any = None

    def start(self, config: Config) -> None:
        """See ``Tracker.start``."""
        from torch.utils.tensorboard import SummaryWriter  # slow: only where it is wanted

        self._writer = SummaryWriter(str(self._folder), purge_step=self._undone or None)

    def log(self, step: int, scalars: Mapping[str, float]) -> None:
        """See ``Tracker.log``."""
        for name, value in scalars.items():
            self._writer.add_scalar(name, value, step)

    def finish(self, summary: Mapping[str, Any] | None) -> None:
        """See ``Tracker.finish``."""
        if self._writer is not None:
            self._writer.close()
