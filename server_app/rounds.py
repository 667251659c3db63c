"""A fleet on Flower: lockstep over the link, rounds in Flower messages.

A round is one train message to each client and its reply. It covers a number of windows: weights
cross between them over the link, and at its ends in the Flower messages themselves. The
coordinator sees none of this.
"""

from __future__ import annotations

import logging
import secrets
import time
from collections.abc import Mapping, Sequence

import numpy as np
from flwr.app import Array, ArrayRecord, ConfigRecord, Message, MessageType, RecordDict
from flwr.serverapp import Grid
from numpy.typing import NDArray

from conf import Config, robot_network, to_yaml, windows_per_round
from env.link import LinkServer, LinkTimeout, Want
from env.link.errors import named
from server_app.session import Costs

log = logging.getLogger(__name__)

POLL_S = 0.05
TOKEN_BYTES = 32


class RoundError(RuntimeError):
    """Flower could not do what the run needs; the message says what and where."""


def deal(robots: int, clients: int) -> list[tuple[int, ...]]:
    """Deals robots to clients in blocks of neighbours, as even as can be.

    Args:
        robots: K.
        clients: 1 to K.

    Returns:
        The robots of each client.
    """
    parts = np.array_split(np.arange(robots), clients)
    return [tuple(int(robot) for robot in part) for part in parts]


def wait_for_nodes(grid: Grid, count: int, deadline_s: float) -> list[int]:
    """Waits until the federation has enough nodes.

    Returns:
        The identities of ``count`` of them, in ascending order.

    Raises:
        RoundError: they did not come in time.
    """
    deadline = time.monotonic() + deadline_s
    while True:
        nodes = sorted(grid.get_node_ids())
        if len(nodes) >= count:
            return nodes[:count]
        if time.monotonic() > deadline:
            raise RoundError(
                f"{len(nodes)} of {count} Flower clients were there after {deadline_s:g} s"
            )
        time.sleep(POLL_S)


class FlowerFleet:
    """The robots of a run that Flower clients hold; implements ``env.link.Fleet``.

    Args:
        config: the run's configuration, with an absolute ``run.dir``.
        grid: Flower's grid.
        link: the listening end of the link.
        nodes: the identity of each client.
        model: the weights that all robots take first, shape (2, P); None if they hold theirs.
    """

    def __init__(
        self,
        config: Config,
        grid: Grid,
        link: LinkServer,
        nodes: Sequence[int],
        model: NDArray[np.float32] | None,
    ) -> None:
        self._config, self._grid, self._link = config, grid, link
        self._blocks = dict(zip(nodes, deal(config.env.robots, len(nodes)), strict=True))
        self._shape = (2, robot_network(config).parameters)
        self._per_round = windows_per_round(config)
        self._round = 0
        self._pending: dict[str, int] = {}
        self._replies: dict[int, Message] = {}
        self._model = model
        self._base = 0
        self._farewell = False
        self._flower_s = 0.0
        self._cpu_s: dict[int, float] = {}
        self._flower_bytes = 0

    def costs(self) -> Costs:
        """What Flower and the link have cost so far."""
        stats = self._link.stats().values()
        return Costs(
            flower_s=self._flower_s,
            client_cpu_s=sum(self._cpu_s.values()),
            bytes_to_robots=sum(block.bytes_sent for block in stats),
            bytes_from_robots=sum(block.bytes_received for block in stats),
            flower_bytes=self._flower_bytes,
            waited_s=sum(block.waited_s for block in stats),
        )

    def tell(self, tick: int, window: int, want: Want, updates: np.ndarray) -> None:
        """See ``Fleet.tell``: opens a round where none is open, and ends it where it is full."""
        if not self._pending:
            self._open_round(window - 1)
        if want is Want.WEIGHTS and window - self._base >= self._per_round:
            want = Want.FAREWELL
        self._farewell = want is Want.FAREWELL
        self._link.tell(tick, window, want, updates)

    def actions(self, tick: int) -> NDArray[np.int32]:
        """See ``Fleet.actions``."""
        return self._link.actions(tick)

    def upload(self, window: int) -> NDArray[np.float32]:
        """See ``Fleet.upload``: from the replies at the end of a round, else over the link."""
        return self._close_round() if self._farewell else self._link.upload(window)

    def download(self, window: int, weights: NDArray[np.float32]) -> None:
        """See ``Fleet.download``: kept for the next train message between rounds."""
        if self._pending:
            self._link.download(window, weights)
        else:
            self._model = weights

    def close(self) -> None:
        """See ``Fleet.close``."""
        self._link.close()

    def _open_round(self, window: int) -> None:
        """Sends a train message to each client and waits until all are on the link."""
        began = time.perf_counter()
        self._round += 1
        self._base = window
        tokens = {
            robot: secrets.token_urlsafe(TOKEN_BYTES)
            for block in self._blocks.values()
            for robot in block
        }
        self._link.admit(list(self._blocks.values()), tokens, self._shape)
        messages = [self._train_message(node, tokens) for node in self._blocks]
        self._replies = {}
        sent = [name for name in self._grid.push_messages(messages) if name]  # None: refused
        if len(sent) != len(messages):
            raise RoundError(f"Flower took {len(sent)} of {len(messages)} messages")
        self._pending = dict(zip(sent, self._blocks, strict=True))
        self._model = None
        deadline_s = self._config.runtime.start_timeout_s
        try:
            self._link.wait_connected(deadline_s, self._collect)
        except LinkTimeout as error:
            raise RoundError(
                f"round {self._round}: {error}; a Flower client never started: does the"
                f" federation run {len(self._blocks)} clients at once?"
            ) from error
        if self._round > 1:
            self._flower_s += time.perf_counter() - began

    def _train_message(self, node: int, tokens: Mapping[int, str]) -> Message:
        block = self._blocks[node]
        host, port = self._link.address
        arrays = {} if self._model is None else {"model": Array(self._model)}
        self._flower_bytes += 0 if self._model is None else self._model.nbytes
        order = ConfigRecord(
            {
                "config": to_yaml(self._config),
                "robots": list(block),
                "tokens": [tokens[robot] for robot in block],
                "host": host,
                "port": port,
                "round": self._round,
                "window": self._base,
            }
        )
        content = RecordDict({"arrays": ArrayRecord(arrays), "order": order})
        return Message(
            content=content,
            message_type=MessageType.TRAIN,
            dst_node_id=node,
            group_id=str(self._round),
        )

    def _collect(self) -> None:
        """Takes the replies that have come.

        Raises:
            RoundError: a client failed.
        """
        missing = [sent for sent, node in self._pending.items() if node not in self._replies]
        for reply in self._grid.pull_messages(missing):
            node = self._pending[reply.metadata.reply_to_message_id]
            if reply.has_error():
                raise RoundError(
                    f"round {self._round}: the Flower client of {named(self._blocks[node])}"
                    f" failed: {reply.error.reason}"
                )
            self._replies[node] = reply

    def _close_round(self) -> NDArray[np.float32]:
        """Waits for the replies and takes the weights out of them, shape (K, 2, P)."""
        began = time.perf_counter()
        deadline = time.monotonic() + self._config.runtime.start_timeout_s
        while True:
            self._collect()
            if len(self._replies) == len(self._blocks):
                break
            if time.monotonic() > deadline:
                late = [self._blocks[n] for n in self._blocks if n not in self._replies]
                raise RoundError(
                    f"round {self._round}: no reply from {'; '.join(map(named, late))}"
                )
            time.sleep(POLL_S)
        uploads = np.empty((self._config.env.robots, *self._shape), dtype=np.float32)
        for node, reply in self._replies.items():
            block = self._blocks[node]
            weights = reply.content.array_records["arrays"]["robots"].numpy()
            if weights.shape != (len(block), *self._shape) or weights.dtype != np.float32:
                raise RoundError(
                    f"round {self._round}: {named(block)} sent {weights.dtype}{weights.shape}"
                )
            uploads[list(block)] = weights
            self._flower_bytes += weights.nbytes
            self._cpu_s[node] = self._cpu_s.get(node, 0.0) + float(
                reply.content.metric_records["metrics"]["cpu_s"]  # type: ignore[arg-type]
            )
        self._pending = {}
        self._flower_s += time.perf_counter() - began
        return uploads
