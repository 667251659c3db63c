"""The recorder of a run: evaluates while it trains and writes its folder as it goes."""

from __future__ import annotations

import csv
import io
import json
import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent import CheckpointError, epsilon_at, naming
from conf import Config, to_yaml
from env.tally import EpisodeMeasures
from server_app.coordinator import Progress
from server_app.evaluation import Evaluator

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
PROGRESS_PERIOD_S = 0.5


def write_atomically(path: Path, text: str, *, durable: bool = True) -> None:
    """Writes a text file so that a reader sees either the old or the new one.

    Args:
        path: the file.
        text: all of it.
        durable: whether it must outlast a crash of the machine.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    with naming(path), temporary.open("w", newline="") as file:
        file.write(text)
        file.flush()
        if durable:
            os.fsync(file.fileno())
    temporary.replace(path)


def report_failure(folder: Path, error: BaseException) -> None:
    """Writes to a run's ``progress.json`` that it failed, and why; a first failure stands."""
    with suppress(OSError):  # of a full disk: the error that stands is the first
        report_state(folder, "failed", f"{type(error).__name__}: {error}")


def report_state(folder: Path, state: str, message: str) -> None:
    """Writes to a run's ``progress.json`` what has become of it; a failure stands.

    Raises:
        OSError: the file cannot be written.
    """
    path = folder / "progress.json"
    status: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    if status.get("state") == "failed":
        return
    status |= {"state": state, "message": message, "written_at": time.time()}
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(status))


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
        return {name: _mean([row[name] for row in rows]) for name in MEASURES}

    def converged(self) -> dict[str, float] | None:
        """The first of three evaluations in a row with success of at least .9, if any."""
        for first, second, third in zip(
            self.evaluations, self.evaluations[1:], self.evaluations[2:], strict=False
        ):
            if min(row["success"] for row in (first, second, third)) >= CONVERGED:
                return {key: first[key] for key in ("episode", "tick", "cpu_s")}
        return None


def _mean(values: list[float]) -> float:
    finite = [value for value in values if np.isfinite(value)]
    return float(np.mean(finite)) if finite else float("nan")


def evaluate(
    evaluator: Evaluator, robots: NDArray[np.float32], ap: NDArray[np.float32], epsilon: float
) -> tuple[dict[str, float], dict[str, float]]:
    """Plays frozen weights with some exploration and greedily.

    Args:
        evaluator: of the run.
        robots: online weights of each robot, shape (K, P), or of all, shape (1, P).
        ap: online weights of the access point, shape (P_AP,).
        epsilon: exploration of the first.

    Returns:
        Measures with exploration, with the path ratio of the greedy ones; and greedy ones.
    """
    explored, greedy = (m.summary() for m in evaluator.play(robots, ap, (epsilon, 0.0)))
    return (
        {**explored, "epsilon": epsilon, "path_ratio": greedy["path_ratio"]},
        {**greedy, "epsilon": 0.0},
    )


class Recorder:
    """Watches a run, implements ``coordinator.Observer``.

    Args:
        config: the run's configuration.
        folder: the run's folder, made here.
        evaluator: plays frozen weights.
        cpu_s: processor time that the run has used so far.
        resumed: what ``marks`` gave where the run goes on from a checkpoint.

    Attributes:
        folder: the run's folder.
        clients: each client, whether it is connected and what it has cost.
        checkpoint: the window of the last checkpoint, if any.
        round: the number of the Flower round, if there are rounds.
    """

    def __init__(
        self,
        config: Config,
        folder: Path,
        evaluator: Evaluator,
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
        self.running = False
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / "config.yaml", to_yaml(config))
        marks = resumed or {"episodes": 0, "evaluations": 0, "training_s": 0.0, "evaluation_s": 0.0}
        self.evaluation_s, self._trained_s = marks["evaluation_s"], marks["training_s"]
        self._metrics = _CsvLog(folder / "metrics.csv", METRICS, marks["episodes"])
        self._evaluations = _CsvLog(
            folder / "evaluations.csv", EVALUATIONS, 2 * marks["evaluations"]
        )
        rows = self._evaluations.kept
        self.history = History(self._metrics.kept, rows[::2], rows[1::2])
        undone = max([-1, *(int(row["tick"]) for row in (*self.history.episodes, *rows))]) + 1
        self._events = _event_writer(folder, undone) if config.run.tensorboard else None
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
        row = {
            "episode": progress.episodes,
            "tick": progress.tick,
            **measures.summary(),
            "epsilon": epsilon_at(self._config.agent.epsilon, progress.tick),
        }
        self.history.episodes.append(row)
        self._metrics.write(row)
        self._log_events("train", row, progress.tick)

    def on_window(
        self, progress: Progress, robots: NDArray[np.float32], ap: NDArray[np.float32]
    ) -> None:
        """Evaluates the aggregated weights where that is due."""
        done = len(self.history.evaluations)
        if progress.episodes // self._config.evaluation.every > done:
            began = time.perf_counter()
            self._evaluate(progress, robots[:, 0], ap[0])
            self.evaluation_s += time.perf_counter() - began
        if time.perf_counter() - self._written > PROGRESS_PERIOD_S:
            self.report("training", progress)

    def _evaluate(
        self, progress: Progress, robots: NDArray[np.float32], ap: NDArray[np.float32]
    ) -> None:
        explored, greedy = evaluate(self._evaluator, robots, ap, self._config.evaluation.epsilon)
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
        """Writes ``progress.json`` for whoever watches from outside."""
        self._written = time.perf_counter()
        recent = self.history.episodes[-10:]
        status: dict[str, Any] = {
            "state": state,
            "message": message,
            "written_at": time.time(),
            "tick": progress.tick,
            "window": progress.window,
            "episode": progress.episodes,
            "episodes": self._config.train.episodes,
            "max_ticks": self._config.train.max_ticks,
            "steps_per_s": self.steps_per_s(progress) if progress.tick else 0.0,
            "elapsed_s": time.perf_counter() - self.began,
            "slots": _mean([row["slots"] for row in recent]) if recent else None,
            "reward": _mean([row["reward"] for row in recent]) if recent else None,
            "ee": _mean([row["ee"] for row in recent]) if recent else None,
            "success": _mean([row["success"] for row in recent]) if recent else None,
            "evaluated": self.history.evaluations[-1]["success"]
            if self.history.evaluations
            else None,
            "checkpoint": self.checkpoint,
            "round": self.round,
            "clients": self.clients(),
        }
        write_atomically(self.folder / "progress.json", json.dumps(status), durable=False)

    def close(self) -> None:
        """Flushes and closes what is open; safe to call again."""
        self._metrics.close()
        self._evaluations.close()
        if self._events is not None:
            self._events.close()

    def _log_events(self, group: str, row: dict[str, float], tick: int) -> None:
        if self._events is None:
            return
        for name, value in row.items():
            if name not in ("episode", "tick") and np.isfinite(value):
                self._events.add_scalar(f"{group}/{name}", value, tick)


def _event_writer(folder: Path, first: int) -> Any:
    """Writes events; those of an earlier attempt from the tick ``first`` on no longer count."""
    from torch.utils.tensorboard import SummaryWriter  # slow to import: only where it is wanted

    return SummaryWriter(str(folder / "tensorboard"), purge_step=first or None)


class _CsvLog:
    """A CSV file of numbers that grows by a row at a time.

    Args:
        path: the file.
        columns: the names of its columns.
        kept: rows of an earlier file that stay; what follows them was undone by a resume.

    Attributes:
        kept: those rows.
    """

    def __init__(self, path: Path, columns: tuple[str, ...], kept: int = 0) -> None:
        self.kept = _read_rows(path, kept) if kept else []
        text = io.StringIO(newline="")
        whole = csv.DictWriter(text, columns)
        whole.writeheader()
        whole.writerows(self.kept)
        write_atomically(path, text.getvalue())
        self._path, self._file = path, path.open("a", newline="")
        self._writer = csv.DictWriter(self._file, columns, extrasaction="ignore")

    def write(self, row: dict[str, float]) -> None:
        """Adds a row; columns that it lacks stay empty."""
        with naming(self._path):
            self._writer.writerow(row)
            self._file.flush()

    def sync(self) -> None:
        """Waits until all rows outlast a crash of the machine."""
        with naming(self._path):
            self._file.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Closes the file, which holds every row that could be written."""
        with suppress(OSError):  # of a full disk, which `write` has told already
            self._file.close()


def check_files(folder: Path, marks: Mapping[str, Any]) -> None:
    """Finds before a run goes on that its files hold what its checkpoint says.

    Raises:
        CheckpointError: a file is missing or shorter.
    """
    _read_rows(folder / "metrics.csv", marks["episodes"])
    _read_rows(folder / "evaluations.csv", 2 * marks["evaluations"])


def _read_rows(path: Path, count: int) -> list[dict[str, float]]:
    """The first rows of a CSV file of numbers; whole numbers stay whole.

    Raises:
        CheckpointError: there are fewer.
    """
    try:
        with path.open(newline="") as file:
            rows = list(islice(csv.DictReader(file), count))
    except FileNotFoundError:
        rows = []
    if len(rows) < count:
        raise CheckpointError(f"{path} has {len(rows)} rows where the checkpoint has {count}")
    return [{name: _number(text) for name, text in row.items()} for row in rows]


def _number(text: str) -> float:
    return int(text) if text.isdecimal() else float(text)
