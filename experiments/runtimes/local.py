"""``runtime=local``: all agents in this process, the robots stacked in one learner."""

from __future__ import annotations

from contextlib import closing
from typing import Any

from client_app.rooms import RoomKeeper
from client_app.state import CheckpointedRobots
from conf import Config, has_rooms
from lockstep import InProcessFleet
from training.building import BuildingRun
from training.checkpoint import Checkpoint
from training.controllers.central import CentralAgent
from training.partition import step_layout
from training.recording.costs import Costs
from training.run_folder import RunFolder
from training.session import TrainingRun


class LocalRooms(RoomKeeper):
    """All rooms of a building in this process; implements ``training.rooms.RoomHost``."""

    forgets = False

    def costs(self) -> Costs:
        """See ``RoomHost.costs``: nothing beside this process."""
        return Costs()

    def clients(self) -> list[dict[str, Any]]:
        """See ``RoomHost.clients``."""
        return []


def train(config: Config, folder: RunFolder, resumed: Checkpoint | None = None) -> dict[str, Any]:
    """Trains in this process, from where the run goes on; returns what ``summary.json`` holds."""
    try:
        state = None if config.state.every is None else folder.state
        if has_rooms(config):
            return BuildingRun(config, folder, resumed).train(LocalRooms(config, state))
        session = TrainingRun(config, folder, resumed)
        if isinstance(session.ap, CentralAgent):
            return session.train(session.ap.fleet)
        robots = tuple(range(config.env.robots))
        with closing(CheckpointedRobots(config, robots, state)) as keeper:
            return session.train(InProcessFleet([(robots, keeper)], step_layout(config)))
    except BaseException as error:
        folder.report_failure(error)
        raise
