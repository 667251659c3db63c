"""The recorder of a run: evaluates while it trains and writes its folder as it goes."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conf import Config
from env.episode import EpisodeMeasures
from training.evaluation import Evaluator
from training.recording.csv_log import CsvLog
from training.recording.history import EVALUATIONS, METRICS, History, episode_row, evaluate, mean
from training.recording.progress import Progress
from training.recording.tracking import Trackers
from training.run_folder import RunFolder

PROGRESS_PERIOD_S = 0.5

log = logging.getLogger(__name__)


class Recorder:
    """Watches a run, implements ``progress.Observer``.

    What the run is to leave behind must be written. ``progress.json``, ``episode.json`` and
    experiment trackers only show it to whoever watches: where they fail, that is said once, and the
    run goes on.

    Args:
        config: the run's configuration.
        folder: the run's folder, made here.
        evaluator: plays frozen weights; None where ``on_window`` is never called.
        cpu_s: processor time that the run has used so far.
        resumed: what ``marks`` gave where the run goes on from a checkpoint.

    Attributes:
        folder: the run's folder.
        clients: each client, whether it is connected and what it has cost.
        checkpoint: the window of the last checkpoint, if any.
        round: the number of the Flower round, if there are rounds.
        losses: of clients, and what became of the run.
    """

    columns: tuple[str, ...] = METRICS
    """Of ``metrics.csv``."""

    def __init__(
        self,
        config: Config,
        folder: RunFolder,
        evaluator: Evaluator | None,
        cpu_s: Callable[[], float],
        resumed: Mapping[str, Any] | None = None,
    ) -> None:
        self._config, self.folder = config, folder
        self._evaluator = evaluator
        self._cpu_s = cpu_s
        self.clients: Callable[[], list[dict[str, Any]]] = list
        self.began = self.started = time.perf_counter()
        self._written = 0.0
        self._ended: float | None = None
        self.checkpoint: int | None = None
        self.round: int | None = None
        self.losses: Sequence[Mapping[str, Any]] = ()
        self.running = False
        self._unwritten: set[str] = set()
        folder.path.mkdir(parents=True, exist_ok=True)
        folder.write_config(config)
        marks = resumed or {"episodes": 0, "evaluations": 0, "training_s": 0.0, "evaluation_s": 0.0}
        self.evaluation_s, self._trained_s = marks["evaluation_s"], marks["training_s"]
        self._metrics = CsvLog(folder.metrics_file, self.columns, marks["episodes"])
        self._evaluations = CsvLog(folder.evaluations_file, EVALUATIONS, 2 * marks["evaluations"])
        rows = self._evaluations.kept
        self.history = History(self._metrics.kept, rows[::2], rows[1::2])
        undone = max([-1, *(int(row["tick"]) for row in (*self.history.episodes, *rows))]) + 1
        self._trackers = Trackers.of(config, folder, undone)
        self._trackers.start(config)
        tick = int(self.history.episodes[-1]["tick"]) if self.history.episodes else 0
        self.report("starting", Progress(tick, 0, len(self.history.episodes)))

    def on_start(self) -> None:
        """Start-up is over."""
        self.started, self.running = time.perf_counter() - self._trained_s, True

    def marks(self) -> dict[str, Any]:
        """How far the files have been written and the clocks have run, once all is on disk."""
        self._metrics.sync()
        self._evaluations.sync()
        return {
            "episodes": len(self.history.episodes),
            "evaluations": len(self.history.evaluations),
            "training_s": time.perf_counter() - self.started,
            "evaluation_s": self.evaluation_s,
        }

    def on_episode(self, progress: Progress, measures: EpisodeMeasures) -> None:
        """Writes a row of ``metrics.csv``."""
        row = episode_row(self._config, progress, measures)
        self.history.episodes.append(row)
        self._metrics.write(row)
        self._log_events("train", row, progress.tick)

    def on_window(
        self, progress: Progress, robots: NDArray[np.float32], ap: NDArray[np.float32]
    ) -> None:
        """Evaluates the aggregated weights where that is due."""
        self._evaluate_where_due(progress, robots[:, 0], ap[0])

    def _evaluate_where_due(self, progress: Progress, robots: NDArray[np.float32], ap: Any) -> None:
        """Evaluates if it is time, and now and then says how far the run is."""
        if progress.episodes // self._config.evaluation.every > len(self.history.evaluations):
            began = time.perf_counter()
            self._evaluate(progress, robots, ap)
            self.evaluation_s += time.perf_counter() - began
        if time.perf_counter() - self._written > PROGRESS_PERIOD_S:
            self.report("training", progress)

    def _evaluate(self, progress: Progress, robots: NDArray[np.float32], ap: Any) -> None:
        assert self._evaluator is not None
        found = evaluate(self._evaluator, robots, ap, self._config.evaluation.epsilon)
        self._write_evaluation(progress, found.explored, found.greedy)
        self.show_episode(self.folder, progress, found.episode)

    def _write_evaluation(
        self, progress: Progress, explored: dict[str, float], greedy: dict[str, float]
    ) -> None:
        """Two rows of ``evaluations.csv``."""
        at = {"episode": progress.episodes, "tick": progress.tick, "cpu_s": self._cpu_s()}
        for rows, name, values in (
            (self.history.evaluations, "evaluation", explored),
            (self.history.greedy, "greedy", greedy),
        ):
            row = {**at, **values}
            rows.append(row)
            self._evaluations.write(row)
            self._log_events(name, row, progress.tick)

    def steps_per_s(self, progress: Progress) -> float:
        """Joint steps per second since the first one, evaluations included."""
        until = self._ended or time.perf_counter()
        return progress.tick / max(until - self.started, 1e-9)

    def end_training(self) -> float:
        """Stops the clock of ``steps_per_s``; returns the seconds since the first tick."""
        self._ended = time.perf_counter()
        return self._ended - self.started

    def report(self, state: str, progress: Progress, message: str = "") -> None:
        """Writes ``progress.json`` for whoever watches from outside, as far as that can be done."""
        self._written = time.perf_counter()
        said = {"state": state, "message": message, "written_at": time.time()}
        status = {**said, **self.status(progress)}
        self._show(self.folder.progress_file.name, lambda: self.folder.write_progress(status))

    def show_episode(
        self, folder: RunFolder, progress: Progress, episode: Mapping[str, Any]
    ) -> None:
        """Writes ``episode.json``: the newest episode of an evaluation, for whoever watches.

        The folder is the run's, or a room's; the episode as ``training.trace.recorded`` gives it.
        """
        at = {"tick": progress.tick, "episode": progress.episodes}
        self._show(folder.episode_file.name, lambda: folder.write_episode({**at, **episode}))

    def _show(self, name: str, write: Callable[[], None]) -> None:
        """Writes a file that only shows the run; says once that it cannot be written."""
        try:
            write()
            self._unwritten.discard(name)
        except OSError as error:
            if name not in self._unwritten:
                log.warning("%s is not written: %s", name, error.strerror or error)
            self._unwritten.add(name)

    def status(self, progress: Progress) -> dict[str, Any]:
        """What ``progress.json`` says of where a run is."""
        recent, evaluations = self.history.episodes[-10:], self.history.evaluations
        return {
            "tick": progress.tick,
            "window": progress.window,
            "episode": progress.episodes,
            "episodes": self._config.train.episodes,
            "max_ticks": self._config.train.max_ticks,
            "steps_per_s": self.steps_per_s(progress) if progress.tick else 0.0,
            "elapsed_s": time.perf_counter() - self.began,
            **{
                name: mean([row[name] for row in recent]) if recent else None
                for name in ("slots", "reward", "ee", "success")
            },
            "evaluated": evaluations[-1]["success"] if evaluations else None,
            "checkpoint": self.checkpoint,
            "round": self.round,
            "losses": len(self.losses),
            "clients": self.clients(),
        }

    def finish(self, summary: Mapping[str, Any]) -> None:
        """Tells trackers what the run has come to."""
        self._trackers.finish(summary)

    def close(self) -> None:
        """Flushes and closes what is open; safe to call again."""
        self._metrics.close()
        self._evaluations.close()
        self._trackers.finish()

    def _log_events(self, group: str, row: dict[str, float], tick: int) -> None:
        scalars = {
            f"{group}/{name}": float(value)
            for name, value in row.items()
            if name not in ("episode", "tick") and np.isfinite(value)
        }
        self._trackers.log(tick, scalars)
