"""``risfleet train``: single runs, and what Ctrl-C and SIGTERM do to them."""

from __future__ import annotations

import json
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from safetensors.numpy import load_file
from train_helpers import ENDLESS, PATIENCE_S, SMALL, Start, is_training, summary, wait_for

from conf import ConfigError, from_yaml
from experiments.cli import main
from experiments.flower.environment import FlowerError
from experiments.runtimes import runner
from experiments.runtimes.folders import dated
from storage.checkpoint_files import digest


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


# --- One run --------------------------------------------------------------------------------------


def test_a_run_says_where_it_is_and_what_it_came_to(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "new" / "run"
    assert main(["train", *SMALL, "run.dir=new/run"]) == 0
    printed = capsys.readouterr()
    assert f"run folder: {folder}" in printed.out
    assert "last 5 in training" in printed.out
    assert str(folder / "summary.json") in printed.out
    assert printed.err == ""
    assert from_yaml((folder / "config.yaml").read_text()).run.dir == str(folder)
    assert summary(folder)["ticks"] == 20


def test_runs_without_a_folder_of_their_own_get_a_new_one_each(tmp_path: Path) -> None:
    changes = [item for item in SMALL if not item.startswith("train")]
    assert main(["train", *changes, "train.max_ticks=1"]) == 0
    assert main(["train", *changes, "train.max_ticks=1"]) == 0
    assert len(list((tmp_path / "runs").glob("*/summary.json"))) == 2


@pytest.mark.parametrize("error", [FlowerError("Port 1 is in use."), ConfigError("run.dir=x")])
def test_what_flower_or_the_user_got_wrong_is_said_without_a_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: Exception
) -> None:
    def fail(*_: Any) -> None:
        raise error

    monkeypatch.setitem(runner.RUNTIMES, "local", fail)
    assert main(["train", *SMALL]) == (1 if isinstance(error, FlowerError) else 2)
    assert capsys.readouterr().err == f"risfleet: {error}\n"


def test_folders_that_are_asked_for_in_the_same_second_are_different_ones(tmp_path: Path) -> None:
    parent = tmp_path / "multirun"
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: dated(parent, "-k3"), range(24)))
    assert len(set(found)) == len(found) == len(list(parent.iterdir()))


def test_a_folder_that_cannot_be_made_is_said_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "runs").symlink_to(tmp_path / "unmounted" / "disk")
    assert main(["train", *SMALL]) == 2
    assert "allowed is a folder that can be made (" in capsys.readouterr().err


# --- Ctrl-C ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "status", "name"),
    [
        (signal.SIGINT, 130, "Ctrl-C"),
        pytest.param(signal.SIGTERM, 143, "SIGTERM", marks=pytest.mark.slow),
    ],
)
def test_a_signal_ends_a_run_with_everything_that_it_has_learned(
    tmp_path: Path, start: Start, number: signal.Signals, status: int, name: str
) -> None:
    folder = tmp_path / "run"
    process = start(*ENDLESS, f"run.dir={folder}")
    wait_for(process, lambda: is_training(folder))
    process.send_signal(number)
    printed, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == status, errors
    assert "Stopping at the next aggregation" in printed
    assert f"Stopped early by {name}" in printed
    assert str(folder / "summary.json") in printed
    found = summary(folder)
    assert found["stopped_early"]
    assert found["ticks"] % 10 == 0
    assert digest(load_file(folder / "weights.safetensors")["robots"]) == found["digest"]["robots"]
    assert not (folder / "stop").exists()


def test_a_second_ctrl_c_ends_at_once_and_leaves_nothing_running(
    tmp_path: Path, start: Start
) -> None:
    folder = tmp_path / "run"
    process = start(*ENDLESS, "federation.every=1000000", f"run.dir={folder}")
    metrics = folder / "metrics.csv"
    wait_for(process, lambda: metrics.exists() and metrics.stat().st_size > 300)
    process.send_signal(signal.SIGINT)
    wait_for(process, (folder / "stop").exists)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert not (folder / "stop").exists()
    assert not (folder / "summary.json").exists()
    assert json.loads((folder / "progress.json").read_text())["state"] == "failed"
