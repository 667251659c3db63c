"""``risfleet train``: single runs, sweeps, and what Ctrl-C does to them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from safetensors.numpy import load_file

from agent import digest
from conf import Config, ConfigError, from_yaml
from experiments import local, runner
from experiments.cli import main
from experiments.flower import FlowerError
from experiments.folders import dated
from server_app.session import STOP_FILE

SMALL = (
    "runtime=local",
    "env.robots=2",
    "env.room.cell_m=3",
    "env.motion.max_slots=8",
    "agent.learn_from=4",
    "agent.batch_size=4",
    "train.max_ticks=20",
    "federation.every=10",
    "evaluation.episodes=2",
    "run.figures=false",
    "run.tensorboard=false",
)
PATIENCE_S = 90.0


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def summary(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return content


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


# --- Sweeps ---------------------------------------------------------------------------------------


def test_a_sweep_runs_every_combination(tmp_path: Path) -> None:
    assert main(["train", "-m", *SMALL, "seed=3,4", "run.dir=sweep"]) == 0
    found = [summary(tmp_path / "sweep" / str(job)) for job in range(2)]
    assert [run["seed"] for run in found] == [3, 4]
    assert found[0]["digest"] != found[1]["digest"]


def test_a_sweep_gives_what_single_runs_give(tmp_path: Path) -> None:
    assert main(["train", "-m", *SMALL, "strategy=none,fedavg", "run.dir=sweep"]) == 0
    assert main(["train", *SMALL, "strategy=fedavg", "run.dir=single"]) == 0
    assert summary(tmp_path / "sweep" / "1")["digest"] == summary(tmp_path / "single")["digest"]


def test_a_sweep_over_floor_plans_gives_what_single_runs_give(tmp_path: Path) -> None:
    small = [*SMALL, "env.room.cell_m=1", "env.tasks.start_distance_m=5"]
    assert main(["train", "-m", *small, "env.plan=default,corridor", "run.dir=sweep"]) == 0
    assert main(["train", *small, "env.plan=corridor", "run.dir=single"]) == 0
    found = [from_yaml((tmp_path / "sweep" / str(n) / "config.yaml").read_text()) for n in (0, 1)]
    assert [config.env.plan for config in found] == ["default", "corridor"]
    assert [config.env.room.depth_m for config in found] == [30.0, 18.0]
    assert summary(tmp_path / "sweep" / "1")["digest"] == summary(tmp_path / "single")["digest"]


@pytest.mark.parametrize(
    ("mistake", "part"),
    [
        ("env.plan=hall,office", "env.plan=office: allowed is one of corridor, default, hall"),
        ("env.power.levels=3,1", "env.power.levels=1"),
        ("seed=0,-1", "seed=-1"),
        ("strategy=none,krum", "env.robots of at least 3"),
        ("env.robtos=1,2", "env.robtos is no key"),
        ("runtime=local,cloud", "runtime=cloud"),
        ("seed=0,one", "seed=one"),
        ("++hydra.sweep.subdir=mine", "hydra.sweep.subdir=mine: allowed is run.dir=FOLDER"),
        ("hydra.sweep.dir=mine", "hydra.sweep.dir=mine: allowed is run.dir=FOLDER"),
    ],
)
def test_a_sweep_with_a_mistake_in_any_combination_starts_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], mistake: str, part: str
) -> None:
    assert main(["train", "-m", "runtime=local", "env.robots=2", mistake]) == 2
    said = capsys.readouterr()
    assert part in said.err
    assert said.err.startswith("risfleet: ")
    assert said.err.count("\n") == 1
    assert said.out == ""
    assert list(tmp_path.iterdir()) == []


def test_a_sweep_leaves_a_folder_in_use_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "sweep").mkdir()
    (tmp_path / "sweep" / "notes.txt").write_text("mine")
    assert main(["train", "-m", *SMALL, "seed=0,1", "run.dir=sweep"]) == 2
    assert "run.dir=sweep: allowed is a folder that is new or empty" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "sweep").iterdir()] == ["notes.txt"]


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


def test_a_run_that_fails_leaves_the_rest_of_a_sweep_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail_once(config: Config, folder: Path, resumed: object) -> dict[str, Any]:
        if config.seed == 0:
            raise FlowerError("Port 1 is in use.")
        return local.train(config, folder)

    monkeypatch.setitem(runner.RUNTIMES, "local", fail_once)
    assert main(["train", "-m", *SMALL, "seed=0,1", "run.dir=sweep"]) == 1
    assert capsys.readouterr().err == "risfleet: Port 1 is in use.\n"
    assert summary(tmp_path / "sweep" / "1")["seed"] == 1


def test_ctrl_c_ends_a_whole_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(config: Config, folder: Path, resumed: object) -> dict[str, Any]:
        signal.raise_signal(signal.SIGINT)
        return local.train(config, folder)

    monkeypatch.setitem(runner.RUNTIMES, "local", interrupted)
    assert main(["train", "-m", *SMALL, "seed=0,1", "run.dir=sweep"]) == 130
    assert summary(tmp_path / "sweep" / "0")["stopped_early"]
    assert not (tmp_path / "sweep" / "1").exists()


# --- Ctrl-C ---------------------------------------------------------------------------------------


def test_the_first_ctrl_c_asks_and_the_second_ends(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)
    with runner.StopOnInterrupt([tmp_path], Console(quiet=True)) as stop:
        signal.raise_signal(signal.SIGINT)
        assert stop.asked
        assert (tmp_path / STOP_FILE).exists()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert not (tmp_path / STOP_FILE).exists()
    assert signal.getsignal(signal.SIGINT) is before


Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts the command in a process of its own; those that remain are killed."""
    started: list[subprocess.Popen[str]] = []

    def run(*arguments: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "experiments.cli", "train", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        started.append(process)
        return process

    yield run
    for process in started:
        process.kill()
        process.communicate()


def wait_for(process: subprocess.Popen[str], condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.05)


def is_training(folder: Path) -> bool:
    try:
        return bool(json.loads((folder / "progress.json").read_text())["state"] == "training")
    except (OSError, ValueError):
        return False


def test_ctrl_c_ends_a_run_with_everything_that_it_has_learned(
    tmp_path: Path, start: Start
) -> None:
    folder = tmp_path / "run"
    endless = [item for item in SMALL if not item.startswith("train")]
    process = start(*endless, "train.episodes=100000000", f"run.dir={folder}")
    wait_for(process, lambda: is_training(folder))
    process.send_signal(signal.SIGINT)
    printed, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, errors
    assert "Stopping at the next aggregation" in printed
    assert "Stopped early by Ctrl-C" in printed
    assert str(folder / "summary.json") in printed
    found = summary(folder)
    assert found["stopped_early"]
    assert found["ticks"] % 10 == 0
    assert digest(load_file(folder / "weights.safetensors")["robots"]) == found["digest"]["robots"]
    assert not (folder / STOP_FILE).exists()


def test_a_second_ctrl_c_ends_at_once_and_leaves_nothing_running(
    tmp_path: Path, start: Start
) -> None:
    folder = tmp_path / "run"
    endless = [item for item in SMALL if not item.startswith(("train", "federation"))]
    changes = ["federation.every=1000000", "train.episodes=100000000"]
    process = start(*endless, *changes, f"run.dir={folder}")
    metrics = folder / "metrics.csv"
    wait_for(process, lambda: metrics.exists() and metrics.stat().st_size > 300)
    process.send_signal(signal.SIGINT)
    wait_for(process, (folder / STOP_FILE).exists)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert not (folder / STOP_FILE).exists()
    assert not (folder / "summary.json").exists()
    assert json.loads((folder / "progress.json").read_text())["state"] == "failed"
