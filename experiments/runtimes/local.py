"""``runtime=local``: all agents in this process, the robots stacked in one learner."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import numpy as np
from numpy.typing import NDArray

from client_app.state import CheckpointedRobots
from conf import Config
from lockstep import Expect, LocalFleet
from training.checkpoint import Checkpoint
from training.controllers.central import CentralAgent
from training.partition import step_layout
from training.run_folder import RunFolder
from training.session import TrainingRun


class InProcessFleet(LocalFleet):
    """A local fleet without rounds: no Flower reply carries the last weights, so it takes them."""

    _farewell = False

    def send_step(self, tick: int, window: int, expect: Expect, updates: np.ndarray) -> None:
        """See ``Fleet.send_step``."""
        super().send_step(tick, window, expect, updates)
        self._farewell = expect is Expect.END_ROUND

    def upload(self, window: int) -> NDArray[np.float32]:
        """See ``Fleet.upload``."""
        return self._uploaded() if self._farewell else super().upload(window)


def train(config: Config, folder: RunFolder, resumed: Checkpoint | None = None) -> dict[str, Any]:
    """Trains in this process.

    Args:
        config: the run's configuration.
        folder: the run's folder.
        resumed: where the run goes on, if it does not begin.

    Returns:
        What ``summary.json`` holds.
    """
    try:
        session = TrainingRun(config, folder, resumed)
        if isinstance(session.ap, CentralAgent):
            return session.train(session.ap.fleet)
        robots = tuple(range(config.env.robots))
        state = None if config.state.every is None else folder.state
        with closing(CheckpointedRobots(config, robots, state)) as keeper:
            return session.train(InProcessFleet([(robots, keeper)], step_layout(config)))
    except BaseException as error:
        folder.report_failure(error)
        raise
