"""Softmax regression on made-up data with momentum, federated by FedAdam; the runs repeat."""

import numpy as np
from flwr.app import Array, ArrayRecord, Context, Message, MetricRecord, RecordDict
from flwr.serverapp import Grid, ServerApp
from flwr.serverapp.strategy import FedAdam

from repeatable import Repeatable, client_app, digest

FEATURES, CLASSES, EXAMPLES = 20, 5, 400
client = client_app()
server = ServerApp()


def data(partition):
    """A client's examples: its own share of what one rule labels."""
    rule = np.random.default_rng(0).normal(size=(FEATURES, CLASSES)).astype(np.float32)
    x = np.random.default_rng([1, partition]).normal(size=(EXAMPLES, FEATURES)).astype(np.float32)
    return x, (x @ rule).argmax(axis=1)


@client.train()
def train(message: Message, context: Context) -> Message:
    """Some steps of SGD, whose momentum the client keeps from round to round."""
    partition, number = (
        context.node_config["partition-id"],
        message.content["config"]["server-round"],
    )
    rng = np.random.default_rng([context.run_config["seed"], partition, number])
    weights, (x, y) = message.content["arrays"]["weights"].numpy(), data(partition)
    kept = context.state.get("momentum")
    momentum = kept["weights"].numpy() if kept else np.zeros_like(weights)
    for batch in rng.integers(EXAMPLES, size=(20, 32)):
        scores = np.exp(x[batch] @ weights)
        error = scores / scores.sum(axis=1, keepdims=True) - np.eye(CLASSES, dtype="f4")[y[batch]]
        momentum = np.float32(0.9) * momentum + x[batch].T @ error / np.float32(len(batch))
        weights = weights - np.float32(0.05) * momentum
    context.state["momentum"] = ArrayRecord({"weights": Array(momentum)})
    content = {"arrays": ArrayRecord({"weights": Array(weights)})}
    content["metrics"] = MetricRecord({"num-examples": EXAMPLES})
    return Message(RecordDict(content), reply_to=message)


@client.evaluate()
def evaluate(message: Message, context: Context) -> Message:
    """The share of a client's examples that the global model gets right."""
    x, y = data(context.node_config["partition-id"])
    right = ((x @ message.content["arrays"]["weights"].numpy()).argmax(axis=1) == y).mean()
    metrics = MetricRecord({"num-examples": EXAMPLES, "accuracy": float(right)})
    return Message(RecordDict({"metrics": metrics}), reply_to=message)


@server.main()
def main(grid: Grid, context: Context) -> None:
    """FedAdam over three of five clients in each round; ends with the model's digest."""
    config = context.run_config
    strategy = FedAdam(fraction_train=0.6, min_train_nodes=3, min_available_nodes=5, eta=0.05)
    if config["repeat"]:
        strategy = Repeatable(strategy, seed=config["seed"], state=config["state-dir"])
    model = ArrayRecord({"weights": Array(np.zeros((FEATURES, CLASSES), dtype=np.float32))})
    result = strategy.start(grid=grid, initial_arrays=model, num_rounds=config["rounds"])
    print("digest", digest(result.arrays), result.evaluate_metrics_clientapp[config["rounds"]])
