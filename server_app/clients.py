"""The Flower clients of a run: what each is asked and replies, and who takes a lost one's place.

A round is one train message to each client and its reply. The robots of a client are its block; the
node that holds a block may change while a run waits for one that was lost.
"""

from __future__ import annotations

import logging
import secrets
import time
from collections.abc import Iterable

import numpy as np
from flwr.app import Message
from flwr.serverapp import Grid

from conf import Config, robot_network, waits_for_the_lost
from lockstep import LinkServer, Payload, RobotLost
from lockstep.errors import named, one_line
from server_app.nodes import DIED, MOST_FAILURES, RoundError, held_by, placed
from server_app.round_messages import RoundStart, read_reply, train_message
from training.partition import Block, partition_robots, step_layout

log = logging.getLogger(__name__)

TOKEN_BYTES = 32
TEND_S = 1.0


class Clients:
    """All clients of a run, one on each node; robots are dealt to them in blocks.

    The link's certificate is PEM, empty without TLS.

    Attributes:
        places: the node of each block.
        replies: of the round, as far as they have come.
        round: the number of the round that was opened last, from 1.
        shape: of one robot's weights, (2, P).
        flower_bytes: bytes of weights in Flower messages, both ways, by block.
        cpu_s: processor time of each block's clients.
    """

    def __init__(
        self, config: Config, grid: Grid, link: LinkServer, nodes: list[int], certificate: str = ""
    ) -> None:
        self._config, self._grid, self._link = config, grid, link
        self._certificate = certificate
        self._waits = waits_for_the_lost(config)
        blocks = partition_robots(config.env.robots, len(nodes))
        self.places: dict[Block, int] = dict(zip(blocks, nodes, strict=True))
        self.replies: dict[Block, Message] = {}
        self.round = 0
        self.shape = (2, robot_network(config).parameters)
        self.flower_bytes: dict[Block, int] = dict.fromkeys(blocks, 0)
        self.cpu_s: dict[Block, float] = dict.fromkeys(blocks, 0.0)
        self._opening = RoundStart(0)
        self._tokens: dict[int, str] = {}
        self._pending: dict[Block, str] = {}
        self._sent_at: dict[Block, float] = {}
        self._failures: dict[Block, int] = dict.fromkeys(blocks, 0)
        self._known: set[int] = set()
        self._held: dict[int, frozenset[int]] = {}
        self._tended = 0.0

    def announce(self, opening: RoundStart) -> None:
        """Opens a round on the link, and sends a train message to each client that is free.

        One whose last message is still open gets its message once Flower says that it has ended.

        Raises:
            RoundError: Flower does not take a message.
        """
        self.round += 1
        self._opening, self.replies = opening, {}
        self._failures = dict.fromkeys(self.places, 0)
        self._known = set(self._grid.get_node_ids())
        self._renew(robot for block in self.places for robot in block)
        self._link.admit(list(self.places), self._tokens, self.shape)
        self._send([block for block in self.places if block not in self._pending])

    def holders(self) -> dict[Block, int]:
        """The node of each block, where nodes keep states of their own; else none.

        Raises:
            RoundError: some robots' state is on no node.
        """
        if self._config.runtime.connection is None:
            return {}
        self._held |= held_by(self._grid, self._config, sorted(self._grid.get_node_ids()))
        return placed(list(self.places), self._held)

    def reopen(self, opening: RoundStart) -> None:
        """Lets clients that are started anew in this round begin it otherwise."""
        self._opening = opening
        self._failures = dict.fromkeys(self.places, 0)

    def collect(self) -> None:
        """Takes the replies that have come.

        Raises:
            RobotLost: the process of a client died.
            RoundError: a client failed.
        """
        for block, reason in self._collect().items():
            if DIED in reason:
                window = self._opening.window
                where = f"in round {self.round}, which began after window {window}"
                raise RobotLost(block, where, "its process died without a word")
            raise RoundError(self._failure(block, reason))

    def supervise(self) -> None:
        """Once a second, looks after the clients that are not on the link.

        One that has ended is started anew on its node. A node that has gone is replaced by one
        that has joined; where nodes keep their state to themselves, by one that holds the robots'.

        Raises:
            RoundError: a client fails again and again.
        """
        if time.monotonic() - self._tended < TEND_S:
            return
        self._tended = time.monotonic()
        for block, reason in self._collect().items():
            self._failures[block] += 1
            if self._failures[block] > MOST_FAILURES:
                raise RoundError(self._failure(block, reason))
            log.warning(self._failure(block, reason))
        free = self._link.free()
        online = set(self._grid.get_node_ids()) if free else set()
        for block in free:
            self._forget_dead(block, online)
            node = self._node_for(block, online)
            if node is not None:
                self._restart(block, node)

    def missing(self) -> list[Block]:
        """The clients that have not replied in this round.

        Raises:
            RobotLost: one has ended without a reply, where the run waits for the lost, or died.
            RoundError: one failed, where the run does not wait.
        """
        where = f"at the end of round {self.round}"
        if self._waits:
            for block, reason in self._collect().items():
                raise RobotLost(block, where, reason)
        else:
            self.collect()
        waiting = [block for block in self.places if block not in self.replies]
        if waiting and self._waits:
            online = set(self._grid.get_node_ids())
            for block in waiting:
                if self.places[block] not in online:
                    raise RobotLost(block, where, "its Flower node has gone")
                if block not in self._pending:  # it came back to the link by itself, too late
                    raise RobotLost(block, where, "Flower had given it up and takes no reply")
        return waiting

    def uploads(self) -> Payload:
        """The weights in the replies of all clients, see ``lockstep.Fleet.upload``.

        Raises:
            RoundError: some are not of this type or shape.
        """
        rows: dict[int, Payload] = {}
        layout = step_layout(self._config)
        for block, reply in self.replies.items():
            weights, spent_s = read_reply(reply, block, self.shape[1], self.round, layout)
            rows |= dict(zip(block, weights, strict=True))
            self.flower_bytes[block] += weights.nbytes
            self.cpu_s[block] += spent_s
        return np.stack([rows[robot] for robot in range(self._config.env.robots)])

    # --- Messages ---------------------------------------------------------------------------------

    def _renew(self, robots: Iterable[int]) -> None:
        self._tokens |= {robot: secrets.token_urlsafe(TOKEN_BYTES) for robot in robots}

    def _send(self, blocks: list[Block]) -> None:
        """Sends train messages; one that Flower does not take is sent again, if the run waits.

        It takes none for a node that has gone.
        """
        for block in blocks:
            self.replies.pop(block, None)  # to a message of a round that was given up
        messages = [self._train_message(block) for block in blocks]
        names = list(self._grid.push_messages(messages))
        sent = {block: name for block, name in zip(blocks, names, strict=False) if name}
        if len(sent) != len(messages) and not self._waits:
            raise RoundError(f"Flower took {len(sent)} of {len(messages)} messages")
        self._pending |= sent
        self._sent_at |= dict.fromkeys(sent, time.monotonic())

    def _train_message(self, block: Block) -> Message:
        if self._opening.model is not None:
            self.flower_bytes[block] += self._opening.model.nbytes
        tokens = {robot: self._tokens[robot] for robot in block}
        start, node, where = self._opening, self.places[block], self._link.address
        return train_message(
            self._config, start, self.round, node, tokens, where, self._certificate
        )

    def _collect(self) -> dict[Block, str]:
        """Takes the replies that have come; returns why clients ended without one."""
        failed: dict[Block, str] = {}
        block_of = {sent: block for block, sent in self._pending.items()}
        for reply in self._grid.pull_messages(list(block_of)):
            block = block_of[reply.metadata.reply_to_message_id]
            del self._pending[block]
            if reply.has_error():
                failed[block] = str(reply.error.reason)
            else:
                self.replies[block] = reply
        return failed

    def _failure(self, block: Block, reason: str) -> str:
        said = one_line(reason)
        return f"round {self.round}: the Flower client of {named(block)} failed: {said}"

    # --- Replacing --------------------------------------------------------------------------------

    def _forget_dead(self, block: Block, online: set[int]) -> None:
        """Expects no reply to a message any more whose node went offline, or kept silent too long.

        A SuperNode that is started again with the same key is the same node to Flower, but knows
        nothing of the message.
        """
        silent_s = time.monotonic() - self._sent_at.get(block, 0.0)
        late = silent_s > self._config.runtime.start_timeout_s
        if self.places[block] not in online or late:
            self._pending.pop(block, None)

    def _node_for(self, block: Block, online: set[int]) -> int | None:
        """The node on which to start a block's client anew; None where none is, or not yet."""
        node = self.places[block]
        if block not in self._pending and node in online:
            return node
        others = online - set(self.places.values())
        if node in online:  # it may still come, unless one that has just joined is its successor
            others -= self._known
        return next((other for other in sorted(others) if self._suits(other, block)), None)

    def _suits(self, node: int, block: Block) -> bool:
        """Whether a node has what a block's robots go on from."""
        if self._config.runtime.connection is None or not self._opening.resumed:
            return True  # all nodes share one folder of checkpoints, or there are none
        if node not in self._held:
            self._held |= held_by(self._grid, self._config, [node])
        return set(block) <= self._held[node]

    def _restart(self, block: Block, node: int) -> None:
        log.info("%s: a client is started on node %d", named(block), node)
        self._renew(block)
        self._link.renew(block, self._tokens)
        self.places[block] = node
        self._send([block])
