"""How far honest robots' uploads lie from each other, and whom Krum picks (docs/robustness.md).

``python tools/krum_distances.py KEY=VALUE ...`` trains in this process with Krum's rule watched.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterable
from typing import Any

import numpy as np
from flwr.app import ArrayRecord, Message, MetricRecord
from flwr.serverapp.strategy import Krum

from agent import single_threaded
from conf import compose
from experiments.cli import main
from training.aggregation.own import register_strategy


class Watched(Krum):
    """Krum that notes every window: who was picked, and lengths of steps and between uploads."""

    seen: list[tuple[int, bool, float, float]] = []  # noqa: RUF012 - of the one run of this process

    def configure_train(self, server_round: int, arrays: ArrayRecord, *rest: Any) -> Any:
        """Keeps what robots started from."""
        self.given = arrays.to_numpy_ndarrays()
        return super().configure_train(server_round, arrays, *rest)

    def aggregate_train(
        self, server_round: int, replies: Iterable[Message]
    ) -> tuple[ArrayRecord | None, MetricRecord | None]:
        """Picks as Krum does, and notes it."""
        answers = list(replies)
        rows = np.stack([_flat(message.content["arrays"]) for message in answers])
        found = super().aggregate_train(server_round, answers)
        assert found[0] is not None
        picked = int(np.argmin(np.abs(rows - _flat(found[0])).max(axis=1)))
        steps = np.linalg.norm(rows - self.given[0].ravel(), axis=1)
        apart = np.linalg.norm(rows[:, None] - rows[None], axis=-1)
        pairs = apart[np.triu_indices(len(rows), 1)]
        shortest = picked == int(np.argmin(steps))
        self.seen.append((picked, shortest, float(steps.mean()), float(pairs.mean())))
        return found


def _flat(record: Any) -> np.ndarray:
    return np.asarray(record.to_numpy_ndarrays()[0], np.float64).ravel()


def measure(overrides: list[str]) -> None:
    """Trains, and prints what was seen."""
    single_threaded()
    register_strategy("watched", Watched)
    given = ["runtime=local", "strategy=own", "strategy.target=watched", *overrides]
    robots = compose(given).env.robots
    with tempfile.TemporaryDirectory() as folder:
        if main(["train", *given, f"run.dir={folder}/run"]):
            raise SystemExit(1)
    picked, shortest, steps, apart = (
        np.array(column) for column in zip(*Watched.seen, strict=True)
    )
    there = steps > 0  # windows before learning begins, and the strategy's trial, move nothing
    picked, shortest = picked[there], shortest[there]
    steps, apart = steps[there], apart[there]
    print(f"windows: {len(picked)}")
    print("picked, by robot:", np.round(np.bincount(picked, minlength=robots) / len(picked), 2))
    print(f"same robot as in the window before: {np.mean(picked[1:] == picked[:-1]):.2f}")
    print(f"the robot with the shortest step: {shortest.mean():.2f}")
    print(f"length of a step: {steps.mean():.4f}; between two uploads: {apart.mean():.4f}")
    print(f"ratio (1.41 where steps are orthogonal, 0 where equal): {np.mean(apart / steps):.2f}")


if __name__ == "__main__":
    measure(sys.argv[1:])
