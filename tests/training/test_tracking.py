"""Experiment trackers: what they are told, that a run outlives them, and the real ones."""

from __future__ import annotations

import csv
import logging
import os
import random
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import psutil  # type: ignore[import-untyped, unused-ignore]
import pytest

from conf import Config
from env.world import World
from experiments.cli import main
from experiments.runtimes import local
from training import resume
from training.recording import tracking
from training.recording.history import MEASURES
from training.recording.tracking import Trackers
from training.run_folder import RunFolder

Tiny = Callable[..., Config]
ID = "0123456789abcdef"


class Listener:
    """A tracker that keeps what it is told, and fails where it is to."""

    def __init__(self, name: str = "Listener", fails: str = "") -> None:
        self.name, self.fails = name, fails
        self.started: list[Config] = []
        self.logged: list[tuple[int, dict[str, float]]] = []
        self.finished: list[Mapping[str, Any] | None] = []

    def start(self, config: Config) -> None:
        """Keeps the configuration."""
        self.started.append(config)
        self._maybe_fail("start")

    def log(self, step: int, scalars: Mapping[str, float]) -> None:
        """Keeps the values."""
        self.logged.append((step, dict(scalars)))
        self._maybe_fail("log")

    def finish(self, summary: Mapping[str, Any] | None) -> None:
        """Keeps the summary."""
        self.finished.append(summary)
        self._maybe_fail("finish")

    def _maybe_fail(self, where: str) -> None:
        if where == self.fails:
            raise OSError(28, "No space left on device")

    def values(self, name: str) -> list[tuple[int, float]]:
        """Ticks and values of one name."""
        return [(step, scalars[name]) for step, scalars in self.logged if name in scalars]


def listen(monkeypatch: pytest.MonkeyPatch, *listeners: Listener) -> None:
    monkeypatch.setattr(Trackers, "of", classmethod(lambda cls, *_: cls(listeners)))


def train(config: Config) -> dict[str, Any]:
    return local.train(config, RunFolder.of(config))


def column(folder: Path, name: str) -> list[tuple[int, float]]:
    """Ticks and finite values of a column of the metrics."""
    with (folder / "metrics.csv").open(newline="") as file:
        found = [(int(row["tick"]), float(row[name])) for row in csv.DictReader(file)]
    return [(tick, value) for tick, value in found if np.isfinite(value)]


# --- What trackers are told -----------------------------------------------------------------------


def test_a_tracker_hears_the_configuration_all_rows_and_the_summary(
    tiny: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    listener = Listener()
    listen(monkeypatch, listener)
    config = tiny({"run.dir": str(tmp_path)})
    summary = train(config)
    assert listener.started == [config]
    assert listener.finished == [summary]
    for name in ("reward", "success", "path_ratio"):
        assert listener.values(f"train/{name}") == column(tmp_path, name)
    for group in ("evaluation", "greedy"):
        assert len(listener.values(f"{group}/success")) == summary["episodes"] // 2
    assert all(np.isfinite(v) for _, scalars in listener.logged for v in scalars.values())


def test_a_tracker_hears_of_each_room_and_of_all_together(
    tiny_building: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    listener = Listener()
    listen(monkeypatch, listener)
    summary = train(tiny_building({"run.dir": str(tmp_path)}))
    groups = {name.partition("/")[0] for _, scalars in listener.logged for name in scalars}
    rooms = {f"room_{path.name}" for path in (tmp_path / "rooms").iterdir()}
    assert groups == {"train", "evaluation", "greedy", "rooms", "held_out_rooms", *rooms}
    assert len(rooms) == 4
    assert listener.finished == [summary]
    last = listener.values("rooms/success")[-1]
    assert last == (40, summary["evaluation"]["greedy"]["success"])


def test_a_tracker_hears_that_a_run_has_failed(
    tiny: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaking(*_: Any) -> Any:
        raise ArithmeticError("weights are not finite")

    listener = Listener()
    listen(monkeypatch, listener)
    monkeypatch.setattr(World, "step", breaking)
    with pytest.raises(ArithmeticError):
        train(tiny({"run.dir": str(tmp_path)}))
    assert listener.finished == [None]


# --- Failures -------------------------------------------------------------------------------------


@pytest.mark.parametrize("fails", ["start", "log", "finish"])
def test_a_tracker_that_fails_is_closed_and_the_others_go_on(
    tiny: Tiny,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    fails: str,
) -> None:
    broken, whole = Listener("Broken", fails), Listener("Whole")
    listen(monkeypatch, broken, whole)
    summary = train(tiny({"run.dir": str(tmp_path)}))
    assert caplog.messages == ["no events for Broken from here on: No space left on device"]
    assert broken.finished == [summary if fails == "finish" else None]
    assert len(broken.logged) == {"start": 0, "log": 1}.get(fails, len(whole.logged))
    assert whole.values("train/reward") == column(tmp_path, "reward")
    assert whole.finished == [summary]


@pytest.mark.parametrize("key", ["wandb", "mlflow"])
def test_a_tracker_that_is_not_installed_is_said_before_anything_starts(
    tiny_overrides: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    key: str,
) -> None:
    folder = tmp_path / "run"
    monkeypatch.setattr(tracking, "version", lambda name: "unknown")
    assert main(["train", *tiny_overrides, f"run.{key}=true", f"run.dir={folder}"]) == 2
    said = capsys.readouterr().err
    allowed = f"false until it is installed: pip install 'risfleet[{key}]'"
    assert said.splitlines() == [f"risfleet: run.{key}=True: allowed is {allowed}."]
    assert not folder.exists()


# --- The real ones --------------------------------------------------------------------------------


@pytest.fixture
def _nowhere_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """No variable of whoever runs the tests leads a tracker elsewhere."""
    for name in [name for name in os.environ if name.startswith(("WANDB_", "MLFLOW_"))]:
        monkeypatch.delenv(name)


@pytest.fixture
def _untouched() -> Any:
    """Random generators, the hook of errors and the process's children stay as they were."""
    before = random.getstate(), np.random.get_state()[1].tolist(), sys.excepthook  # noqa: NPY002
    children = {child.pid for child in psutil.Process().children(recursive=True)}
    yield
    after = random.getstate(), np.random.get_state()[1].tolist(), sys.excepthook  # noqa: NPY002
    assert after == before
    assert {child.pid for child in psutil.Process().children(recursive=True)} <= children


def in_two_parts(tiny: Tiny, folder: Path, changes: Mapping[str, Any]) -> dict[str, Any]:
    """A run that ends after 60 ticks and is resumed to 100."""
    own = {"run.dir": str(folder), "run.id": ID, "state.every": 3, **changes}
    train(tiny({**own, "train.max_ticks": 60}))
    config, checkpoint = resume.read([f"resume={folder}", "train.max_ticks=100"])
    return local.train(config, RunFolder(folder), checkpoint)


@pytest.mark.usefixtures("_nowhere_else", "_untouched")
def test_wandb_holds_both_parts_of_a_run_under_its_id(tiny: Tiny, tmp_path: Path) -> None:
    pytest.importorskip("wandb")
    plain = train(tiny({"run.dir": str(tmp_path / "plain")}))
    run = tmp_path / "run"
    assert in_two_parts(tiny, run, {"run.wandb": True})["digest"] == plain["digest"]
    parts = sorted((run / "wandb").glob("offline-run-*"))
    files = [file for part in parts for file in part.glob("*.wandb")]
    assert [file.name for file in files] == [f"run-{ID}.wandb"] * 2
    for file in files:
        assert b"train/reward" in file.read_bytes()
    assert plain["digest"]["robots"].encode() in files[-1].read_bytes()
    assert "WANDB_SERVICE" not in os.environ


@pytest.mark.usefixtures("_nowhere_else", "_untouched")
def test_mlflow_holds_a_run_and_what_follows_as_one(tiny: Tiny, tmp_path: Path) -> None:
    pytest.importorskip("mlflow")
    from mlflow import MlflowClient

    plain = train(tiny({"run.dir": str(tmp_path / "plain")}))
    run = tmp_path / "run"
    summary = in_two_parts(tiny, run, {"run.mlflow": True})
    assert summary["digest"] == plain["digest"]
    client = MlflowClient(tracking_uri=f"sqlite:///{run / 'mlflow' / 'mlflow.db'}")
    experiment = client.get_experiment_by_name("risfleet")
    (found,) = client.search_runs([experiment.experiment_id])
    assert (found.info.run_name, found.info.status) == ("run", "FINISHED")
    assert found.data.tags["risfleet.run"] == ID
    assert found.data.tags["risfleet.digest.ap"] == plain["digest"]["ap"]
    assert found.data.params["env.robots"] == "3"
    history = client.get_metric_history(found.info.run_id, "train/reward")
    logged = sorted((point.step, point.value) for point in history)
    assert logged == column(run, "reward")
    greedy = summary["evaluation"]["greedy"]
    for name in MEASURES:
        assert found.data.metrics[f"final/greedy/{name}"] == pytest.approx(
            greedy[name], nan_ok=True
        )
    assert not logging.getLogger("training.recording.tracking").disabled
