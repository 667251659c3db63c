"""``runtime=local``: all agents in this process, the robots stacked in one learner."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from client_app.robots import RobotGroup
from conf import Config
from env.link import LocalFleet, Want
from server_app.session import Session


class InProcessFleet(LocalFleet):
    """A local fleet without rounds: the last weights are uploaded like all others."""

    def tell(self, tick: int, window: int, want: Want, updates: np.ndarray) -> None:
        """See ``Fleet.tell``."""
        super().tell(tick, window, Want.WEIGHTS if want is Want.FAREWELL else want, updates)


def train(config: Config, folder: Path) -> dict[str, Any]:
    """Trains in this process.

    Args:
        config: the run's configuration.
        folder: the run's folder.

    Returns:
        What ``summary.json`` holds.
    """
    session = Session(config, folder)
    robots = tuple(range(config.env.robots))
    group = RobotGroup(config, robots)
    group.download(0, session.initial_weights())
    return session.train(InProcessFleet([(robots, group)]))
