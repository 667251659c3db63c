"""What a run has cost, and what it says of itself in its checkpoints and at its end."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from conf import Config, fingerprint, version
from storage.checkpoint_files import Writer
from storage.checkpoint_layout import owner
from training.checkpoint import Checkpoint, State, save_server
from training.exchange.accounting import spent
from training.recording.costs import Costs
from training.recording.history import MEASURES
from training.recording.progress import Progress
from training.recording.recorder import Recorder
from training.run_folder import RunFolder

FINAL_EPSILON = 0.05
LAST_EVALUATIONS = 5


class Accounts:
    """What runs of one room and of many have in common: clocks, checkpoints, summary.

    Attributes:
        runtime_costs: what the runtime has cost since this process began.
        writer: of checkpoints.
    """

    def __init__(self, config: Config, folder: RunFolder, resumed: Checkpoint | None) -> None:
        self._config, self._folder = config, folder
        meta: dict[str, Any] = {"spent": {"wall_s": 0.0, "cpu_s": 0.0}, "costs": {}}
        if resumed is not None:
            meta = resumed.meta
        self._began: float = time.perf_counter() - meta["spent"]["wall_s"]
        self._cpu_before: float = time.process_time() - meta["spent"]["cpu_s"]
        self._costs_before = Costs(**meta["costs"])
        self.runtime_costs: Callable[[], Costs] = Costs
        self.writer = Writer()

    def costs(self) -> Costs:
        """What the runtime has cost since the run began."""
        return self._costs_before.plus(self.runtime_costs())

    def cpu_s(self) -> float:
        """Processor time of this process and of the robots' processes since the run began."""
        return time.process_time() - self._cpu_before + self.costs().client_cpu_s

    def checkpoint(
        self, window: int, arrays: State, recorder: Recorder, **spent_too: float
    ) -> None:
        """Writes the server's checkpoint of a window, once the one before it is there.

        It is of the windows that have been played. What was spent beside wall and processor time,
        in s, goes into it ``also``.

        Raises:
            OSError: the one before it could not be written.
        """
        meta = {
            **owner(self._config.run.id),
            "spent": {
                "wall_s": time.perf_counter() - self._began,
                "cpu_s": time.process_time() - self._cpu_before,
                **spent_too,
            },
            "costs": asdict(self.costs()),
            "marks": recorder.marks(),
            "fingerprint": fingerprint(self._config.env),
            "losses": list(recorder.losses),
        }
        save_server(self.writer, self._folder.state, window, arrays, meta)
        recorder.checkpoint = window

    def summary(
        self,
        recorder: Recorder,
        progress: Progress,
        scores: tuple[dict[str, float], dict[str, float]],
        digests: dict[str, str],
        trained_s: float,
        *,
        stopped: bool,
    ) -> dict[str, Any]:
        """The part of ``summary.json`` that runs of one room and of many have in common.

        Args:
            recorder: the run's.
            progress: where it ended.
            scores: what the final weights are worth, explored and greedy.
            digests: of the final weights, by whose they are.
            trained_s: seconds since the first tick.
            stopped: whether the run was asked to stop.
        """
        config, costs, history = self._config, self.costs(), recorder.history
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
            "converged": history.converged(),
            "evaluation": {
                "greedy": {name: greedy[name] for name in MEASURES},
                "eps05": {name: explored[name] for name in MEASURES},
                "last5": history.last(LAST_EVALUATIONS),
                "last5_greedy": history.last(LAST_EVALUATIONS, greedy=True),
            },
            "stopped_early": stopped,
            "wall_s": time.perf_counter() - self._began,
            "cpu_s": self.cpu_s(),
            "clients": recorder.clients(),
            "losses": list(recorder.losses),
        }
