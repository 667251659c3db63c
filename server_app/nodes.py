"""Which Flower node holds which robots, or rooms."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence

from flwr.app import ConfigRecord, Message, MessageType, RecordDict
from flwr.serverapp import Grid

from conf import Config, to_yaml
from training.partition import Block

POLL_S = 0.05
SURVEY_S = 60.0
"""The longest wait for what nodes say they hold."""
MOST_FAILURES = 5
"""Messages to one client that may fail, in a round or in a row, before the run is given up."""
DIED = "ActorDiedError"
"""What Flower's reason for a missing reply holds where one of Ray's processes was killed."""


class RoundError(RuntimeError):
    """Flower could not do what the run needs; the message says what and where."""


def wait_for_nodes(grid: Grid, count: int, deadline_s: float) -> list[int]:
    """Waits for the federation's nodes; returns the first ``count`` identities, ascending.

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


def held_by(grid: Grid, config: Config, nodes: Sequence[int]) -> dict[int, frozenset[int]]:
    """The robots, or rooms, whose state each node holds; none of one that does not answer."""
    order = ConfigRecord({"config": to_yaml(config)})
    asked = [
        Message(RecordDict({"order": order}), message_type=MessageType.QUERY, dst_node_id=node)
        for node in nodes
    ]
    pending = dict(zip(grid.push_messages(asked), nodes, strict=True))
    held: dict[int, frozenset[int]] = dict.fromkeys(nodes, frozenset())
    deadline = time.monotonic() + SURVEY_S
    while pending and time.monotonic() < deadline:
        for reply in grid.pull_messages(list(pending)):
            node = pending.pop(reply.metadata.reply_to_message_id)
            if not reply.has_error():
                found = reply.content.config_records["held"]["robots"]
                held[node] = frozenset(int(each) for each in found)  # type: ignore[union-attr]
        if pending:
            time.sleep(POLL_S)
    return held


def placed(blocks: Sequence[Block], held: Mapping[int, Iterable[int]]) -> dict[Block, int]:
    """Gives each block to a node of its own that holds all its robots, by augmenting paths.

    Args:
        blocks: the robots of each client.
        held: the robots whose state each node holds.

    Raises:
        RoundError: some block's robots are on no node that is left for it.
    """
    owner: dict[int, Block] = {}

    def place(block: Block, tried: set[int]) -> bool:
        for node in sorted(held):
            if node in tried or not set(block) <= set(held[node]):
                continue
            tried.add(node)
            if node not in owner or place(owner[node], tried):
                owner[node] = block
                return True
        return False

    for block in blocks:
        if not place(block, set()):
            names = ", ".join(map(str, block))
            raise RoundError(
                f"no node holds the checkpoints of robots {names}: is its SuperNode running, with"
                " the state-dir that it had?"
            )
    return {block: node for node, block in owner.items()}
