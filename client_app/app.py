"""The ClientApp: wraps robots' DQNs and their slices of the environment for one round."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from flwr.app import Array, ArrayRecord, ConfigRecord, Context, Message, MetricRecord, RecordDict
from flwr.clientapp import ClientApp

from agent import single_threaded
from client_app.robots import RobotGroup
from client_app.state import Keeper, load_state
from conf import Config, fingerprint, from_yaml
from conf.places import STATE
from env.link import serve

app = ClientApp()


@dataclass(frozen=True)
class Order:
    """What the ServerApp asks of a client in a round.

    Attributes:
        config: the run's configuration.
        robots: the robots that this client holds.
        tokens: a secret for each of them, for this round.
        address: where the link is.
        window: the windows that have been played before this round.
    """

    config: Config
    robots: tuple[int, ...]
    tokens: Sequence[str]
    address: tuple[str, int]
    window: int

    @classmethod
    def read(cls, record: ConfigRecord) -> Order:
        """Reads the order out of a train message."""
        return cls(
            config=from_yaml(str(record["config"])),
            robots=tuple(int(robot) for robot in record["robots"]),  # type: ignore[union-attr]
            tokens=[str(token) for token in record["tokens"]],  # type: ignore[union-attr]
            address=(str(record["host"]), int(record["port"])),  # type: ignore[arg-type]
            window=int(record["window"]),  # type: ignore[arg-type]
        )


@app.train()
def train(message: Message, context: Context) -> Message:
    """Serves one round of windows and replies with the robots' weights."""
    single_threaded()
    began = time.process_time()
    order = Order.read(message.content.config_records["order"])
    group = RobotGroup(order.config, order.robots)
    folder = Path(str(order.config.run.dir)) / STATE
    if order.window:
        load_state(group, folder, order.window)
    model = message.content.array_records["arrays"].get("model")
    if model is not None:
        group.download(order.window, model.numpy())
    with closing(Keeper(group, folder, order.config.state.every)) as keeper:
        serve(
            order.address,
            order.robots,
            order.tokens,
            keeper,
            fingerprint=fingerprint(order.config.env),
            timeout_s=order.config.federation.link.timeout_s,
            patience_s=order.config.federation.link.patience_s,
            n_parameters=group.parameters,
        )
    content = RecordDict(
        {
            "arrays": ArrayRecord({"robots": Array(group.upload())}),
            "metrics": MetricRecord({"cpu_s": time.process_time() - began}),
        }
    )
    return Message(content=content, reply_to=message)
