"""A run that died goes on from its last whole checkpoint, to the bits of one that did not."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from agent import checkpoints
from conf.places import robot_windows, server_folder
from experiments.cli import main
from server_app import checkpoint, session

CHANGES = ("train.max_ticks=120", "state.every=3", "evaluation.every=1")


@pytest.fixture
def train(tiny_overrides: list[str], tmp_path: Path) -> Callable[..., Path]:
    """Trains the tiny fleet from the command line, into a folder of this name."""

    def run(name: str, *changes: str) -> Path:
        folder = tmp_path / name
        assert main(["train", *tiny_overrides, *CHANGES, *changes, f"run.dir={folder}"]) == 0
        return folder

    return run


def summary(folder: Path) -> dict:
    return json.loads((folder / "summary.json").read_text())


def rows(path: Path) -> list[dict[str, str]]:
    """A CSV file's rows without the clocks."""
    with path.open() as file:
        return [{k: v for k, v in row.items() if k != "cpu_s"} for row in csv.DictReader(file)]


def die_at(monkeypatch: pytest.MonkeyPatch, window: int) -> None:
    """Lets a run fail before the server writes its checkpoint of a window."""
    save = session.save_server

    def fatal(writer, state, at, *rest):
        if at == window:
            raise OSError("the machine is gone")
        save(writer, state, at, *rest)

    monkeypatch.setattr(session, "save_server", fatal)


@pytest.mark.parametrize("strategy", ["fedavg", "none", "fedprox"])
@pytest.mark.parametrize("fading", ["static", "slot"])
def test_a_run_that_died_ends_in_the_same_bits(
    train, strategy, fading, tmp_path, tiny_overrides, monkeypatch
) -> None:
    changes = [f"strategy={strategy}", f"env.channel.fading={fading}"]
    if strategy == "fedprox":
        changes.append("strategy.proximal_mu=0.1")
    whole = train("whole", *changes)
    folder = tmp_path / "died"
    with monkeypatch.context() as patch:
        die_at(patch, 9)
        given = ["train", *tiny_overrides, *CHANGES, *changes, f"run.dir={folder}"]
        with pytest.raises(OSError, match="gone"):
            main(given)
    assert checkpoints(server_folder(folder / "state")) == [3, 6]
    assert main(["train", f"resume={folder}"]) == 0
    assert summary(folder)["digest"] == summary(whole)["digest"]
    for name in ("metrics.csv", "evaluations.csv"):
        assert rows(folder / name) == rows(whole / name)
    for key in ("ticks", "windows", "episodes", "evaluation"):
        assert summary(folder)[key] == summary(whole)[key]


def test_a_run_that_has_ended_can_be_made_longer(train) -> None:
    whole, short = train("whole"), train("short", "train.max_ticks=70")
    assert main(["train", f"resume={short}", "train.max_ticks=120"]) == 0
    assert summary(short)["digest"] == summary(whole)["digest"]


def test_a_torn_checkpoint_leaves_the_one_before_it(train, tmp_path) -> None:
    whole, folder = train("whole"), train("torn")
    state = folder / "state"
    newest = max(robot_windows(state, 1))
    path = robot_windows(state, 1)[newest] / f"checkpoint-{newest:012d}.safetensors"
    path.write_bytes(path.read_bytes()[:-7])
    (folder / "summary.json").unlink()
    assert checkpoint.latest(state, 3).window < newest
    assert main(["train", f"resume={folder}"]) == 0
    assert summary(folder)["digest"] == summary(whole)["digest"]


def test_a_run_may_be_moved(train, tmp_path) -> None:
    whole, folder = train("whole"), train("short", "train.max_ticks=60")
    shutil.move(folder, tmp_path / "elsewhere")
    assert main(["train", f"resume={tmp_path / 'elsewhere'}", "train.max_ticks=120"]) == 0
    assert summary(tmp_path / "elsewhere")["digest"] == summary(whole)["digest"]
    assert not folder.exists()


def test_a_killed_process_can_be_resumed(train, tiny_overrides, tmp_path) -> None:
    length = ("train.max_ticks=6000", "train.episodes=1000000", "state.every=5")
    whole = train("whole", *length)
    folder = tmp_path / "killed"
    command = [sys.executable, "-m", "experiments.cli", "train", *tiny_overrides, *CHANGES]
    process = subprocess.Popen(
        [*command, *length, f"run.dir={folder}"],
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )
    deadline = time.monotonic() + 120
    while len(checkpoints(server_folder(folder / "state"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    if not (folder / "summary.json").exists():
        assert main(["train", f"resume={folder}"]) == 0
    assert summary(folder)["digest"] == summary(whole)["digest"]


def test_what_cannot_be_resumed_is_refused_in_a_sentence(train, tmp_path, capsys) -> None:
    folder = train("ended")
    assert main(["train", f"resume={folder}"]) == 2
    assert "the run has ended" in capsys.readouterr().err
    assert main(["train", f"resume={folder}", "seed=3"]) == 2
    assert "seed=3: allowed beside resume are train.episodes" in capsys.readouterr().err
    assert main(["train", f"resume={folder}", "train.episodes=many"]) == 2
    assert "allowed is a whole number" in capsys.readouterr().err
    assert main(["train", "-m", f"resume={folder}", "train.max_ticks=500,600"]) == 2
    assert "without -m" in capsys.readouterr().err
    assert main(["train", f"resume={tmp_path / 'nowhere'}"]) == 2
    assert "allowed is the folder of a run" in capsys.readouterr().err
    shutil.rmtree(folder / "state" / "robot-02")
    assert main(["train", f"resume={folder}", "train.max_ticks=500"]) == 2
    assert "holds no checkpoint that the server and all 3 robots have" in capsys.readouterr().err


def test_a_run_of_another_version_is_refused(train, monkeypatch, capsys) -> None:
    folder = train("old")
    monkeypatch.setattr("server_app.resume.fingerprint", lambda env: "another")
    assert main(["train", f"resume={folder}", "train.max_ticks=500"]) == 2
    assert "allowed is a run of this version" in capsys.readouterr().err


def test_without_checkpoints_none_are_written(train) -> None:
    folder = train("bare", "state.every=null")
    assert not (folder / "state").exists()
