"""A federation in this process, to test an app without Ray: replies come in any order."""

from __future__ import annotations

import copy
import random
import uuid
from collections.abc import Iterable, Mapping
from typing import Any

from flwr.app import Context, Error, Message, RecordDict
from flwr.app.user_config import UserConfig
from flwr.clientapp import ClientApp
from flwr.serverapp import Grid
from flwr.supercore.run import Run

from repeatable.isolation import within_flower


class LocalGrid(Grid):
    """Runs a client app in this process, a client after the other.

    Nodes have random numbers and answer in a random order, as Flower's do. Messages of Flower's
    need a task: work with it in ``with LocalGrid(...) as grid:``, which makes one up.

    Args:
        app: the clients'.
        clients: how many there are.
        run_config: the run's configuration.
        seed: of the numbers and the order; None: others each time.
    """

    def __init__(
        self,
        app: ClientApp,
        clients: int,
        run_config: Mapping[str, Any] | None = None,
        seed: int | None = None,
    ) -> None:
        self._app, self._random = app, random.Random(seed)
        self._replies: dict[str, Message] = {}
        self._contexts: dict[int, Context] = {}
        for partition in self._random.sample(range(clients), clients):
            node = self._random.getrandbits(63)
            place: UserConfig = {"partition-id": partition, "num-partitions": clients}
            config = dict(run_config or {})
            self._contexts[node] = Context(1, node, place, RecordDict(), config)

    def __enter__(self) -> LocalGrid:
        """Makes a task of Flower's up."""
        self._flower = within_flower()
        self._flower.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        """Leaves nothing of it behind."""
        self._flower.__exit__(*error)

    def get_node_ids(self) -> list[int]:
        """The nodes' numbers."""
        return list(self._contexts)

    def push_messages(self, messages: Iterable[Message]) -> list[str]:
        """Lets clients answer; an exception of one is an error in its reply."""
        answers = {uuid.uuid4().hex: self._answer(message) for message in messages}
        self._replies |= answers
        return list(answers)

    def pull_messages(self, message_ids: Iterable[str]) -> list[Message]:
        """The answers to messages, in a random order."""
        replies = [self._replies.pop(name) for name in message_ids if name in self._replies]
        return self._random.sample(replies, len(replies))

    def send_and_receive(
        self, messages: Iterable[Message], *, timeout: float | None = None
    ) -> list[Message]:
        """Both at once."""
        return self.pull_messages(self.push_messages(messages))

    def create_message(
        self,
        content: RecordDict,
        message_type: str,
        dst_node_id: int,
        group_id: str,
        ttl: float | None = None,
    ) -> Message:
        """Flower's older way to make one."""
        return Message(content, dst_node_id, message_type, ttl=ttl, group_id=group_id)

    def set_run(self, run: Run) -> None:
        """Says which run this is."""
        self._run = run

    @property
    def run(self) -> Run:
        """The run, where one was set."""
        return self._run

    def _answer(self, message: Message) -> Message:
        context = self._contexts[message.metadata.dst_node_id]
        try:
            return self._app(copy.deepcopy(message), context)
        except Exception as error:
            return Message(Error(0, f"{type(error).__name__}: {error}"), reply_to=message)
