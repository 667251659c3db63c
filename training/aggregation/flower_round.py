"""One round of a Flower strategy within this process: messages to virtual nodes, and replies."""

from __future__ import annotations

from typing import cast

import numpy as np
import numpy.typing as npt
from flwr.app import Array, ArrayRecord, ConfigRecord, Message, MetricRecord, RecordDict
from flwr.serverapp import Grid
from flwr.serverapp.strategy import Strategy

WeightRows = npt.NDArray[np.float32]

_ARRAY = "weights"


class _NodeList:
    """The part of Flower's ``Grid`` that ``configure_train`` uses. Robot k is node k + 1."""

    def __init__(self, robots: int) -> None:
        self._robots = robots

    def get_node_ids(self) -> list[int]:
        return list(range(1, self._robots + 1))


def one_round(
    strategy: Strategy, window: int, current: WeightRows, uploads: WeightRows
) -> npt.NDArray[np.float64]:
    """Configures and aggregates: current (R, P) and uploads (K, R, P) give (R, P).

    Robots that a strategy does not ask have nothing to say.
    """
    grid = cast(Grid, _NodeList(len(uploads)))
    messages = strategy.configure_train(window, _record(current), ConfigRecord(), grid)
    replies = [  # by robot: Flower samples in random order
        _reply(strategy, message, _record(uploads[message.metadata.dst_node_id - 1]))
        for message in sorted(messages, key=lambda message: message.metadata.dst_node_id)
    ]
    arrays, _ = strategy.aggregate_train(window, replies)
    if arrays is None:
        raise ValueError(f"{type(strategy).__name__} refuses to aggregate {len(replies)} robots")
    found = arrays[_ARRAY].numpy() if _ARRAY in arrays else None
    if found is None or found.shape != current.shape:
        given = {name: array.shape for name, array in arrays.items()}
        say = f"{given} where {{{_ARRAY!r}: {current.shape}}} is expected"
        raise ValueError(f"{type(strategy).__name__} gave arrays of shapes {say}")
    return found


def _reply(strategy: Strategy, message: Message, arrays: ArrayRecord) -> Message:
    """What a robot answers, under the names that FedAvg and its kin have for it."""
    metrics = MetricRecord({getattr(strategy, "weighted_by_key", "num-examples"): 1})
    name = getattr(strategy, "arrayrecord_key", "arrays")
    content = RecordDict({name: arrays, "metrics": metrics})
    return Message(content, reply_to=message)


def _record(rows: WeightRows) -> ArrayRecord:
    """A record with one array, since Flower's cost is by the array more than by the byte.

    Each message needs a record of its own: some strategies take the arrays out.
    """
    record = ArrayRecord()
    record[_ARRAY] = Array(rows.astype(np.float64))
    return record
