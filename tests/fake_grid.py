"""Flower in small, for tests of the server's side."""

from __future__ import annotations

import threading
import time
import uuid
from collections.abc import Callable, Iterable, Mapping

from flwr.app import ConfigRecord, Context, Error, Message, MessageType, RecordDict

from client_app.app import query, train

Client = Callable[[Message, Context], Message | None]


class FakeGrid:
    """Flower in small: each message runs a client on a thread, which replies or does not.

    Args:
        nodes: how many there are, numbered from 100.
        clients: what each node does when it is to train, counted from 0; the project's ClientApp
            where a node has no entry.
        node_config: of each node, counted from 0.
    """

    def __init__(
        self,
        nodes: int,
        clients: dict[int, Client] | None = None,
        node_config: Callable[[int], Mapping[str, str]] = lambda node: {},
    ) -> None:
        self.nodes = [100 + node for node in range(nodes)]
        self.node_config = node_config
        self.clients = clients or {}
        self.sent: list[Message] = []
        self.threads: list[threading.Thread] = []
        self._replies: dict[str, Message] = {}
        self._given_up: set[str] = set()
        self._lock = threading.Lock()

    def get_node_ids(self) -> Iterable[int]:
        return reversed(self.nodes)

    def push_messages(self, messages: Iterable[Message]) -> Iterable[str]:
        for message in messages:
            if message.metadata.dst_node_id not in self.nodes:
                yield None
                continue
            sent = uuid.uuid4().hex
            message.metadata.__dict__["_message_id"] = sent
            self.sent.append(message)
            self.threads.append(threading.Thread(target=self._work, args=(message,), daemon=True))
            self.threads[-1].start()
            yield sent

    def pull_messages(self, message_ids: Iterable[str]) -> Iterable[Message]:
        with self._lock:
            return [self._replies.pop(sent) for sent in list(message_ids) if sent in self._replies]

    def _work(self, message: Message) -> None:
        node = message.metadata.dst_node_id
        context = Context(1, node, dict(self.node_config(node - 100)), RecordDict(), {})
        handler = self.clients.get(node - 100, train)
        if message.metadata.message_type == MessageType.QUERY:
            handler = query
        try:
            reply = handler(message, context)
        except Exception as error:
            reply = Message(Error(1, f"{type(error).__name__}: {error}"), reply_to=message)
        if reply is not None:
            self._answer(message, reply)

    def _answer(self, message: Message, reply: Message) -> None:
        name = message.metadata.message_id
        with self._lock:
            if name not in self._given_up:
                self._replies[name] = reply

    def give_up(self, node: int) -> None:
        """Answers for a silent node, whose own reply then is not taken; waits until it is heard."""
        message = [m for m in self.sent if m.metadata.dst_node_id == 100 + node][-1]
        self._answer(message, Message(Error(3, "node unavailable"), reply_to=message))
        name = message.metadata.message_id
        self._given_up.add(name)
        while name in self._replies:
            time.sleep(0.01)

    def orders(self, node: int) -> list[ConfigRecord]:
        """What a node was asked, round by round."""
        mine = [m for m in self.sent if m.metadata.dst_node_id == 100 + node]
        return [message.content.config_records["order"] for message in mine]
