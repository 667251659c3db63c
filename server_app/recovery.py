"""A run on Flower that outlives its robots' processes.

A robot that is lost ends the part of the run that is being played. All others wait on the link
until it is back or another process has taken its place; then all go back to the newest checkpoint
that the server and every robot have, and play on from there, to the bits of a run that lost nobody.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Mapping
from typing import Any

from conf import Config, waits_for_the_lost
from lockstep import LinkServer, LinkTimeout, RobotLost
from lockstep.errors import named
from server_app.clients import Clients
from server_app.nodes import RoundError
from server_app.rounds import FlowerFleet
from storage.checkpoint_files import checkpoints
from storage.checkpoint_layout import server_folder
from training.checkpoint import Checkpoint, newest
from training.partition import Block
from training.run_folder import RunFolder
from training.run_log import log_lines
from training.session import TrainingRun

log = logging.getLogger(__name__)

MOST_IN_VAIN = 5
"""Losses in a row without a new checkpoint before a run is given up."""
EARLY = 2
"""Checkpoints of the server's up to which a robot may just not have written its first."""


class RecoveringTrainer:
    """Trains with the clients of a federation, through losses of them.

    The configuration has an absolute ``run.dir`` and a ``run.id``.
    """

    def __init__(
        self, config: Config, folder: RunFolder, link: LinkServer, clients: Clients
    ) -> None:
        self._config, self._folder, self._link, self._clients = config, folder, link, clients
        self._fleet = FlowerFleet(config, link, clients, self._on_round)
        self._session: TrainingRun | None = None
        self._losses: list[dict[str, Any]] = []
        self._in_vain = 0

    def train(self, resumed: Checkpoint | None) -> None:
        """Trains to the end, from the server's newest checkpoint where there is one.

        Raises:
            LinkError: a robot was lost, and is not waited for or did not come back; or it failed.
            RoundError: Flower could not do what was needed.
        """
        with log_lines(self._config.run.id) as self._about:
            if resumed is not None:
                self._losses = list(resumed.meta["losses"])
                if self._config.runtime.name == "deployment":
                    resumed = self._assembled(self._clients.holders())
            while True:
                try:
                    return self._play(resumed)
                except (RobotLost, LinkTimeout) as loss:
                    if not waits_for_the_lost(self._config):
                        raise
                    resumed = self._recover(loss, resumed)

    def _play(self, resumed: Checkpoint | None) -> None:
        """Trains from a checkpoint on, or from the start, until the end or a loss."""
        self._session = TrainingRun(self._config, self._folder, resumed, self._losses)
        self._session.recorder.round = self._clients.round
        self._session.train(self._fleet, self._fleet.costs, self._fleet.clients)

    def _recover(
        self, loss: RobotLost | LinkTimeout, before: Checkpoint | None
    ) -> Checkpoint | None:
        """Waits until all robots are there again; returns where the run goes on."""
        log.warning("%s; waiting for it to come back", loss)
        self._folder.report_state("waiting", str(loss))
        began = time.perf_counter()
        checkpoint = self._assembled({})
        waited_s = time.perf_counter() - began
        window, earlier = (0 if point is None else point.window for point in (checkpoint, before))
        log.warning("all robots are there after %.1f s; back to window %d", waited_s, window)
        self._in_vain = 0 if window > earlier else self._in_vain + 1
        if self._in_vain > MOST_IN_VAIN:
            raise loss
        self._losses.append({"loss": str(loss), "back_to": window, "waited_s": waited_s})
        return checkpoint

    def _assembled(self, places: Mapping[Block, int]) -> Checkpoint | None:
        """Brings all robots to the link; returns the newest checkpoint that all have, if any.

        Raises:
            RoundError: the run is past its first checkpoints, and they have none in common.
        """
        common = self._fleet.assemble(places)
        own = checkpoints(server_folder(self._folder.state))
        checkpoint = newest(self._folder.state, {*common} & {*own}, self._config.run.id)
        if checkpoint is None and len(own) > EARLY:
            held = [f"{named(block)}: {_listed(kept)}" for block, kept in self._link.kept().items()]
            raise RoundError(
                f"the robots have no checkpoint in common with the server, which has those of"
                f" windows {_listed(own)} ({'; '.join(held)}): is each SuperNode's state-dir as it"
                " was? Its log names the files that are damaged"
            )
        return checkpoint

    def _on_round(self, number: int) -> None:
        self._about.round = number
        if self._session is not None:
            self._session.recorder.round = number


def _listed(windows: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(windows))) or "none"
