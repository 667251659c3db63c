"""What every run says of itself at its end."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from conf import Config, fingerprint, version
from training.exchange.accounting import spent
from training.recording.costs import Costs
from training.recording.history import MEASURES
from training.recording.progress import Progress
from training.recording.recorder import Recorder

LAST_EVALUATIONS = 5


def summarise(
    config: Config,
    recorder: Recorder,
    progress: Progress,
    scores: tuple[dict[str, float], dict[str, float]],
    digests: dict[str, str],
    costs: Costs,
    trained_s: float,
) -> dict[str, Any]:
    """The part of ``summary.json`` that runs of one room and of many have in common.

    Args:
        config: the run's.
        recorder: the run's.
        progress: where it ended.
        scores: what the final weights are worth, explored and greedy.
        digests: of the final weights, by whose they are.
        costs: what the runtime has cost.
        trained_s: seconds since the first tick.
    """
    explored, greedy = scores
    return {
        "seed": config.seed,
        "runtime": config.runtime.name,
        "strategy": config.strategy.name,
        "scheme": asdict(config.scheme),
        "robots": config.env.robots,
        "versions": {name: version(name) for name in ("risfleet", "torch", "numpy", "flwr")},
        "fingerprint": fingerprint(config.env),
        "privacy": spent(config, progress.window),
        "digest": digests,
        "ticks": progress.tick,
        "windows": progress.window,
        "episodes": progress.episodes,
        "startup_s": recorder.started - recorder.began,
        "training_s": trained_s,
        "evaluation_s": recorder.evaluation_s,
        "steps_per_s": recorder.steps_per_s(progress),
        "flower_share": costs.flower_s / trained_s,
        "costs": asdict(costs),
        "converged": recorder.history.converged(),
        "evaluation": {
            "greedy": {name: greedy[name] for name in MEASURES},
            "eps05": {name: explored[name] for name in MEASURES},
            "last5": recorder.history.last(LAST_EVALUATIONS),
            "last5_greedy": recorder.history.last(LAST_EVALUATIONS, greedy=True),
        },
    }
