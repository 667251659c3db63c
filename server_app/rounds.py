"""A fleet on Flower: lockstep over the link, rounds in Flower messages.

A round covers a number of windows: weights cross between them over the link, and at the round's
ends in the Flower messages themselves. The coordinator sees none of this.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conf import Config, waits_for_the_lost, windows_per_round
from lockstep import Expect, LinkServer, LinkTimeout, Payload, RobotLost
from lockstep.errors import named
from server_app.clients import Clients
from server_app.nodes import POLL_S, RoundError
from server_app.round_messages import RoundStart
from training.partition import Block
from training.recording.costs import Costs

log = logging.getLogger(__name__)


class FlowerFleet:
    """The robots of a run that Flower clients hold; implements ``lockstep.Fleet``.

    ``on_round`` is called with the number of each round that opens.
    """

    def __init__(
        self,
        config: Config,
        link: LinkServer,
        clients: Clients,
        on_round: Callable[[int], None] = lambda number: None,
    ) -> None:
        self._config, self._link, self._clients, self._on_round = config, link, clients, on_round
        self._waits = waits_for_the_lost(config)
        self._per_round = windows_per_round(config)
        self._model: Payload | None = None
        self._base = 0
        self._open = self._farewell = False
        self._flower_s = 0.0

    def costs(self) -> Costs:
        """What Flower and the link have cost so far."""
        stats = self._link.stats().values()
        return Costs(
            flower_s=self._flower_s,
            client_cpu_s=sum(self._clients.cpu_s.values()),
            bytes_to_robots=sum(block.bytes_sent for block in stats),
            bytes_from_robots=sum(block.bytes_received for block in stats),
            flower_bytes=sum(self._clients.flower_bytes.values()),
            waited_s=sum(block.waited_s for block in stats),
        )

    def clients(self) -> list[dict[str, Any]]:
        """Each client: whether it is connected, and what it has cost since this process began."""
        stats = self._link.stats()
        free = self._link.free() if self._open else list(stats)
        return [
            {
                "robots": list(block),
                "connected": block not in free,
                "bytes_sent": link.bytes_sent,
                "bytes_received": link.bytes_received,
                "flower_bytes": self._clients.flower_bytes[block],
                "exchanges": link.frames_received,
                "awaited_s": link.waited_s,
                "ahead_s": link.ahead_s,
                "cpu_s": self._clients.cpu_s[block],
            }
            for block, link in stats.items()
        ]

    # --- The conversation -------------------------------------------------------------------------

    def send_step(self, tick: int, window: int, expect: Expect, updates: np.ndarray) -> None:
        """See ``Fleet.send_step``: opens a round where none is open, ends it where it is full."""
        if not self._open:
            self._open_round(window - 1)
        if expect is Expect.WEIGHTS and window - self._base >= self._per_round:
            expect = Expect.END_ROUND
        self._farewell = expect is Expect.END_ROUND
        self._link.send_step(tick, window, expect, updates)

    def actions(self, tick: int) -> NDArray[np.int32]:
        """See ``Fleet.actions``."""
        return self._link.actions(tick)

    def upload(self, window: int) -> Payload:
        """See ``Fleet.upload``: from the replies at the end of a round, else over the link."""
        return self._close_round() if self._farewell else self._link.upload(window)

    def download(self, window: int, weights: Payload) -> None:
        """See ``Fleet.download``: kept for the next train message between rounds."""
        if self._open:
            self._link.download(window, weights)
        else:
            self._model = weights

    def begin(self, window: int, model: NDArray[np.float32] | None) -> None:
        """See ``Fleet.begin``: over the link in an open round, else with the next message."""
        if self._open:
            self._link.begin(window, model)
            self._base = window
        else:
            self._model = model

    def close(self) -> None:
        """See ``Fleet.close``."""
        self._link.close()

    # --- Rounds -----------------------------------------------------------------------------------

    def assemble(self, places: Mapping[Block, int]) -> list[int]:
        """Brings every robot to the link, wherever it was, for ``begin`` to send it somewhere.

        Clients that are connected stay. Those that are not may come back by themselves; one that
        has ended is started anew, on the node that ``places`` has for its block.

        Returns:
            The windows, ascending, of which all robots have a checkpoint.

        Raises:
            LinkTimeout: a robot did not come within ``federation.loss_timeout_s``.
            RoundError: its client fails again and again.
        """
        self._clients.places |= places
        deadline = time.monotonic() + self._config.federation.loss_timeout_s
        start = RoundStart(0, resumed=True)
        if self._open and not self._farewell:
            self._clients.reopen(start)
        else:
            self._announce(start)
        while True:
            try:
                self._link.wait_connected(deadline - time.monotonic(), self._clients.supervise)
                return self._link.halt()
            except RobotLost as loss:
                log.warning("%s, while others were awaited", loss)

    def _announce(self, opening: RoundStart) -> None:
        self._open, self._farewell = True, False
        self._on_round(self._clients.round + 1)
        self._clients.announce(opening)

    def _open_round(self, window: int) -> None:
        """Sends a train message to each client and waits until all are on the link."""
        began = time.perf_counter()
        self._base, model, self._model = window, self._model, None
        self._announce(RoundStart(window, model))
        clients = self._clients
        try:
            self._link.wait_connected(
                self._config.runtime.start_timeout_s,
                clients.supervise if self._waits else clients.collect,
            )
        except LinkTimeout as error:
            raise RoundError(
                f"round {clients.round}: {error}; a Flower client never started: does the"
                f" federation run {len(clients.places)} clients at once?"
            ) from error
        if clients.round > 1:
            self._flower_s += time.perf_counter() - began

    def _close_round(self) -> Payload:
        """Waits for the replies and takes the weights out of them, see ``Fleet.upload``."""
        began = time.perf_counter()
        deadline = time.monotonic() + self._config.runtime.start_timeout_s
        while late := self._clients.missing():
            if time.monotonic() > deadline:
                names = "; ".join(map(named, late))
                raise RoundError(f"round {self._clients.round}: no reply from {names}")
            time.sleep(POLL_S)
        self._open = False
        uploads = self._clients.uploads()
        self._flower_s += time.perf_counter() - began
        return uploads
