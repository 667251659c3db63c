"""The Flower messages of a round: what a client is asked, and the weights that it replies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from flwr.app import Array, ArrayRecord, ConfigRecord, Message, MessageType, RecordDict

from conf import Config, to_yaml
from lockstep.errors import named
from lockstep.messages import Layout, Payload, checked_upload, of_block
from server_app.nodes import RoundError
from training.partition import Block


@dataclass(frozen=True, eq=False)
class RoundStart:
    """What a train message says of the state in which a round begins.

    Attributes:
        window: windows played before it, whose checkpoint the robots take; 0 is the run's start.
        model: the weights that they take then, as ``Fleet.download``'s, or None.
        resumed: whether they are to go on from checkpoints, which the link will say.
    """

    window: int
    model: Payload | None = None
    resumed: bool = False


def train_message(
    config: Config,
    start: RoundStart,
    number: int,
    node: int,
    tokens: Mapping[int, str],
    address: tuple[str, int],
    certificate: str,
) -> Message:
    """What the client on a node is asked in the round of this number.

    Each of its robots has a token, its secret for this round, and joins the link at its host and
    port; the link's certificate is PEM, empty without TLS.
    """
    order = ConfigRecord(
        {
            "config": to_yaml(config),
            "robots": list(tokens),
            "tokens": list(tokens.values()),
            "host": address[0],
            "port": address[1],
            "certificate": certificate,
            "round": number,
            "window": start.window,
        }
    )
    arrays = {} if start.model is None else {"model": Array(of_block(start.model, list(tokens)))}
    return Message(
        content=RecordDict({"arrays": ArrayRecord(arrays), "order": order}),
        message_type=MessageType.TRAIN,
        dst_node_id=node,
        group_id=str(number),
    )


def read_reply(
    reply: Message, block: Block, parameters: int, number: int, layout: Layout
) -> tuple[Payload, float]:
    """A client's reply at the end of a round: its robots' weights, and its processor time in s.

    Raises:
        RoundError: the weights are of another type or shape.
    """
    weights = reply.content.array_records["arrays"]["robots"].numpy()
    try:
        weights = checked_upload(weights, len(block), parameters, layout)
    except ValueError as error:
        raise RoundError(f"round {number}: {named(block)} replied wrongly: {error}") from error
    spent = reply.content.metric_records["metrics"]["cpu_s"]
    return weights, float(spent)  # type: ignore[arg-type]
