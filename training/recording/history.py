"""What a run has shown: episodes, evaluations of frozen weights, and when it converged."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent import epsilon_at
from conf import Config
from env.episode import EpisodeMeasures
from training.evaluation import Evaluator
from training.recording.progress import Progress
from training.trace import Trace, recorded

MEASURES = (
    "success",
    "path_ratio",
    "ee",
    "ee_bits_per_joule",
    "sum_rate",
    "min_rate",
    "sic_violations",
    "projections",
)
"""What an evaluation reports, in ``summary.json`` and elsewhere."""

METRICS = ("episode", "tick", "slots", "reward", *MEASURES, "epsilon")
EVALUATIONS = ("episode", "tick", "cpu_s", "epsilon", *MEASURES)
CONVERGED = 0.9


@dataclass
class History:
    """What a run has shown so far: a row an episode and a row an evaluation, explored and greedy.

    The path ratio of an explored row is that of the greedy one beside it: random moves lengthen
    any path.
    """

    episodes: list[dict[str, float]] = field(default_factory=list)
    evaluations: list[dict[str, float]] = field(default_factory=list)
    greedy: list[dict[str, float]] = field(default_factory=list)

    def last(self, count: int, *, greedy: bool = False) -> dict[str, float]:
        """The mean of the last evaluations, measure by measure."""
        rows = (self.greedy if greedy else self.evaluations)[-count:]
        return {name: mean([row[name] for row in rows]) for name in MEASURES}

    def converged(self) -> dict[str, float] | None:
        """The first of three evaluations in a row with success of at least .9, if any."""
        for first, second, third in zip(
            self.evaluations, self.evaluations[1:], self.evaluations[2:], strict=False
        ):
            if min(row["success"] for row in (first, second, third)) >= CONVERGED:
                return {key: first[key] for key in ("episode", "tick", "cpu_s")}
        return None


def episode_row(config: Config, progress: Progress, measures: EpisodeMeasures) -> dict[str, float]:
    """A row of ``METRICS``: an episode that has just ended."""
    return {
        "episode": progress.episodes,
        "tick": progress.tick,
        **measures.summary(),
        "epsilon": epsilon_at(config.agent.epsilon, progress.tick),
    }


def mean(values: list[float]) -> float:
    """The mean of those that are finite; nan if none is."""
    finite = [value for value in values if np.isfinite(value)]
    return float(np.mean(finite)) if finite else float("nan")


@dataclass(frozen=True)
class Evaluation:
    """What frozen weights are worth.

    Attributes:
        explored: measures with exploration, the path ratio that of the greedy ones.
        greedy: measures without.
        arrivals: share of the greedy episodes in which each robot arrives, shape (K,).
        episode: the first greedy episode, as ``training.trace.recorded`` gives it.
    """

    explored: dict[str, float]
    greedy: dict[str, float]
    arrivals: NDArray[np.float64]
    episode: dict[str, Any]


def evaluate(
    evaluator: Evaluator, robots: NDArray[np.float32], ap: NDArray[np.float32], epsilon: float
) -> Evaluation:
    """Plays frozen weights, as in ``Evaluator.play``, with some exploration and greedily."""
    first = evaluator.episodes  # of the second block of worlds, that without exploration
    trace = Trace(slice(first, first + 1))
    explored, greedy = evaluator.play(robots, ap, (epsilon, 0.0), serve=trace.see)
    trace.finish(evaluator.world)
    found = greedy.summary()
    return Evaluation(
        {**explored.summary(), "epsilon": epsilon, "path_ratio": found["path_ratio"]},
        {**found, "epsilon": 0.0},
        np.isfinite(greedy.path_ratio).mean(axis=0),
        recorded(trace, evaluator.world, greedy),
    )
