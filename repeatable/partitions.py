"""Which node holds which partition, and messages in that order: Flower numbers nodes at random."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable
from typing import Any

from flwr.app import ConfigRecord, Message, MessageType, RecordDict
from flwr.common.constant import ErrorCode
from flwr.serverapp import Grid

KEY = "repeatable"
"""The name of our record in messages, and of the question for a node's partition."""

_GONE = {
    ErrorCode.MESSAGE_UNAVAILABLE,
    ErrorCode.REPLY_MESSAGE_UNAVAILABLE,
    ErrorCode.NODE_UNAVAILABLE,
}
"""What Flower answers for a node that has died, and that it lists a while longer."""

_ASK_S = 120.0
_POLL_S = 0.2
_SAY_S = 10.0


class ClientLostError(RuntimeError):
    """A client gave no result; the message says which, in which round, and why."""


class Partitions:
    """The nodes of a federation by partition, asked once each.

    Args:
        count: of partitions; None takes the nodes' word, ``num-partitions``.
    """

    def __init__(self, count: int | None) -> None:
        self._count = count
        self._of_node: dict[int, int] = {}
        self._asked: dict[int, Message] = {}

    def nodes(self, grid: Grid) -> dict[int, int]:
        """The node of each partition, as soon as all are there; the newest where several are.

        Raises:
            ClientLostError: a node does not say which partition it holds.
        """
        said = time.monotonic()
        while True:
            there = set(grid.get_node_ids())
            self._ask(grid, sorted(there - self._of_node.keys()))
            held = {part: node for node, part in self._of_node.items() if node in there}
            count = self._count or 0
            if count and all(partition in held for partition in range(count)):
                return {partition: held[partition] for partition in range(count)}
            if time.monotonic() - said > _SAY_S:
                said = time.monotonic()
                missing = ", ".join(str(each) for each in range(count) if each not in held) or "all"
                logging.getLogger("flwr").info("Waiting for the nodes of partitions: %s", missing)
            time.sleep(_POLL_S)

    def addressed(
        self, messages: Iterable[Message], nodes: dict[int, int], order: dict[str, Any]
    ) -> list[Message]:
        """Messages to the nodes that hold the partitions.

        Args:
            messages: a strategy's, for the nodes that it sees.
            nodes: from ``nodes``.
            order: what clients are told besides.
        """
        messages = list(messages)
        self._asked = {message.metadata.dst_node_id - 1: message for message in messages}
        if len(self._asked) != len(messages):
            raise ValueError("a strategy that sends a client several messages at once has no order")
        sent = []
        for partition, message in sorted(self._asked.items()):
            about = message.metadata
            content = RecordDict({**message.content, KEY: ConfigRecord({**order})})
            node, kind, group = nodes[partition], about.message_type, about.group_id
            sent.append(Message(content, node, kind, ttl=about.ttl, group_id=group))
        return sent

    def ordered(self, server_round: int, replies: Iterable[Message]) -> list[Message]:
        """Replies to the last messages in the order of partitions, as from what a strategy sees.

        Raises:
            ClientLostError: there is none of a client that was asked, or an error.
        """
        found = {self._of_node.get(reply.metadata.src_node_id): reply for reply in replies}
        asked = sorted(self._asked.items())
        lost = [
            f"{partition} ({_reason(found.get(partition))})"
            for partition, _ in asked
            if partition not in found or found[partition].has_error()
        ]
        if lost:
            say = f"round {server_round}: no result from partitions {', '.join(lost)}"
            raise ClientLostError(say)
        return [Message(found[partition].content, reply_to=message) for partition, message in asked]

    def _ask(self, grid: Grid, nodes: Iterable[int]) -> None:
        kind = f"{MessageType.QUERY}.{KEY}"
        questions = [Message(RecordDict(), dst_node_id=node, message_type=kind) for node in nodes]
        if not questions:
            return
        for reply in grid.send_and_receive(questions, timeout=_ASK_S):
            node = reply.metadata.src_node_id
            if reply.has_error():
                if reply.error.code in _GONE:
                    continue
                raise ClientLostError(
                    f"node {node} does not say which partition it holds, as one whose ClientApp is"
                    f" made by repeatable.client_app does: {_reason(reply)}"
                )
            answer: Any = reply.content.config_records[KEY]
            self._of_node[node] = answer["partition"]
            self._count = self._count or answer["count"]


def _reason(reply: Message | None) -> str:
    """Why a client gave no result, as Flower tells it: the last line of a traceback."""
    if reply is None:
        return "no answer in time"
    lines = (reply.error.reason or "no reason given").strip().splitlines()
    return lines[-1].strip()


class View:
    """A federation as a strategy sees it: partition k is node k + 1; all else is the grid's own."""

    def __init__(self, grid: Grid, count: int) -> None:
        self._grid, self._count = grid, count

    def get_node_ids(self) -> list[int]:
        """The numbers of the nodes, ascending."""
        return list(range(1, self._count + 1))

    def __getattr__(self, name: str) -> Any:
        """What else Flower's has."""
        return getattr(self._grid, name)
