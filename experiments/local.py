"""``runtime=local``: all agents in this process, the robots stacked in one learner."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from client_app.robots import RobotGroup
from client_app.state import Keeper, load_state
from conf import Config
from conf.places import STATE
from env.link import LocalFleet, Want
from server_app.checkpoint import Checkpoint
from server_app.session import Session


class InProcessFleet(LocalFleet):
    """A local fleet without rounds: the last weights are uploaded like all others."""

    def tell(self, tick: int, window: int, want: Want, updates: np.ndarray) -> None:
        """See ``Fleet.tell``."""
        super().tell(tick, window, Want.WEIGHTS if want is Want.FAREWELL else want, updates)


def train(config: Config, folder: Path, resumed: Checkpoint | None = None) -> dict[str, Any]:
    """Trains in this process.

    Args:
        config: the run's configuration.
        folder: the run's folder.
        resumed: where the run goes on, if it does not begin.

    Returns:
        What ``summary.json`` holds.
    """
    session = Session(config, folder, resumed)
    robots = tuple(range(config.env.robots))
    group = RobotGroup(config, robots)
    state, window = folder / STATE, 0
    if resumed is not None:
        window = resumed.window
        load_state(group, state, window)
    if (model := session.model()) is not None:
        group.download(window, model)
    fleet = InProcessFleet([(robots, group)])
    with closing(Keeper(group, state, config.state.every)) as keeper:
        return session.train(fleet, keep=keeper.save if config.state.every else _never)


def _never(window: int, last: bool) -> None:
    """Keeps nothing."""
