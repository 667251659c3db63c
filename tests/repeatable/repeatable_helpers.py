"""The app of docs/examples/repeatable_app, and a federation of it in this process."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
from flwr.app import Array, ArrayRecord, ConfigRecord, Message, MetricRecord, RecordDict
from flwr.serverapp.strategy import FedAdam, Result, Strategy

from repeatable import LocalGrid, Repeatable, client_app, digest

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "repeatable_app"
CLIENTS = 5


def example() -> Any:
    """The example's module."""
    spec = importlib.util.spec_from_file_location("repeatable_example", EXAMPLE / "app.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


APP = example()


def fedadam() -> FedAdam:
    """Three of five clients, with moments on the server."""
    return FedAdam(fraction_train=0.6, min_train_nodes=3, min_available_nodes=CLIENTS, eta=0.05)


def model(*shape: int) -> ArrayRecord:
    return ArrayRecord({"weights": Array(np.zeros(shape or (20, 5), dtype=np.float32))})


def play(
    strategy: Strategy,
    rounds: int = 4,
    *,
    app: Any = None,
    order: int | None = None,
    state: Path | str = "",
    clients: int = CLIENTS,
    initial: ArrayRecord | None = None,
    **options: Any,
) -> Result:
    """Plays a run; nodes' numbers and the order of replies come from ``order``."""
    config = {"seed": 0, "state-dir": str(state)}
    with LocalGrid(app or APP.client, clients, config, order) as grid:
        return strategy.start(grid, initial or model(), rounds, **options)


def wrapped(seed: int = 0, state: Path | str = "", **options: Any) -> Repeatable:
    return Repeatable(options.pop("strategy", None) or fedadam(), seed=seed, state=state, **options)


def digest_of(*arguments: Any, **options: Any) -> str:
    return digest(play(*arguments, **options).arrays)


def answering(function: Any) -> Any:
    """A client app whose training gives what a function makes of a message and its context."""
    app = client_app()

    @app.train()
    def train(message: Message, context: Any) -> Message:
        values = np.asarray(function(message, context))
        content = {"arrays": ArrayRecord({"weights": Array(values)})}
        metrics = MetricRecord({"num-examples": 1})
        return Message(RecordDict({**content, "metrics": metrics}), reply_to=message)

    @app.evaluate()
    def evaluate(message: Message, context: Any) -> Message:
        metrics = MetricRecord({"num-examples": 1, "loss": float("nan")})
        return Message(RecordDict({"metrics": metrics}), reply_to=message)

    return app


def config(**values: Any) -> ConfigRecord:
    return ConfigRecord(values)
