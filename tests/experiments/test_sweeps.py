"""``risfleet train -m``: a run for each combination, with any launcher, and again where it was."""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
from pathlib import Path
from typing import Any

import pytest
from train_helpers import ENDLESS, PATIENCE_S, SMALL, Start, is_training, summary, wait_for

from conf import Config, from_yaml
from experiments.cli import main
from experiments.flower.environment import FlowerError
from experiments.runtimes import local, runner
from experiments.runtimes.folders import run_lock
from training.run_folder import RunFolder

JOBLIB = "hydra/launcher=joblib"


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a sweep over seeds 0 and 1 that has ended; not to be written to."""
    folder: Path = tmp_path_factory.mktemp("ended") / "sweep"
    assert main(["train", "-m", *SMALL, "seed=0,1", f"run.dir={folder}"]) == 0
    return folder


@pytest.fixture
def sweep(ended: Path, tmp_path: Path) -> Path:
    """A copy of it in the working folder."""
    return shutil.copytree(ended, tmp_path / "sweep")


AGAIN = ("train", "-m", *SMALL, "seed=0,1", "run.dir=sweep")
"""The command of that sweep, once more."""


def test_a_sweep_over_a_group_gives_what_single_runs_give(tmp_path: Path) -> None:
    assert main(["train", "-m", *SMALL, "strategy=none,fedavg", "run.dir='my sweep'"]) == 0
    assert main(["train", *SMALL, "strategy=fedavg", "run.dir=single"]) == 0
    assert summary(tmp_path / "my sweep" / "1")["digest"] == summary(tmp_path / "single")["digest"]


def test_a_sweep_runs_every_combination_as_single_runs(ended: Path, tmp_path: Path) -> None:
    found = [summary(ended / str(job)) for job in range(2)]
    assert [run["seed"] for run in found] == [0, 1]
    assert found[0]["digest"] != found[1]["digest"]
    assert main(["train", *SMALL, "seed=1", "run.dir=single"]) == 0
    assert found[1]["digest"] == summary(tmp_path / "single")["digest"]


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
    assert main([*AGAIN]) == 2
    said = "/sweep: allowed is a folder that is new or empty, or of this sweep"
    assert said in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "sweep").iterdir()] == ["notes.txt"]


def test_a_run_that_fails_leaves_the_rest_of_a_sweep_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail_once(config: Config, folder: RunFolder, resumed: object) -> dict[str, Any]:
        if config.seed == 0:
            raise FlowerError("Port 1 is in use.")
        return local.train(config, folder)

    monkeypatch.setitem(runner.RUNTIMES, "local", fail_once)
    assert main([*AGAIN]) == 1
    assert capsys.readouterr().err == "risfleet: Port 1 is in use.\n"
    assert summary(tmp_path / "sweep" / "1")["seed"] == 1


def test_ctrl_c_ends_a_whole_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(config: Config, folder: RunFolder, resumed: object) -> dict[str, Any]:
        signal.raise_signal(signal.SIGINT)
        return local.train(config, folder)

    monkeypatch.setitem(runner.RUNTIMES, "local", interrupted)
    assert main([*AGAIN]) == 130
    assert summary(tmp_path / "sweep" / "0")["stopped_early"]
    assert not (tmp_path / "sweep" / "1").exists()


# --- The folder -----------------------------------------------------------------------------------


def written_at(sweep: Path) -> dict[str, int]:
    """When each run's summary was written."""
    return {path.parent.name: path.stat().st_mtime_ns for path in sweep.glob("*/summary.json")}


@pytest.mark.parametrize("form", ["run.dir='{}'", 'run.dir="{}"', "++run.dir={}", "run.dir={}"])
def test_runs_that_have_ended_are_never_overwritten(
    sweep: Path, capsys: pytest.CaptureFixture[str], form: str
) -> None:
    sweep = sweep.rename(sweep.with_name("my sweep, größer"))
    before = written_at(sweep)
    assert sorted(before) == ["0", "1"]
    assert main(["train", "-m", *SMALL, "seed=7,8", form.format(sweep)]) == 2
    assert "allowed is a folder that is new, empty or of this run" in capsys.readouterr().err
    assert written_at(sweep) == before


def test_the_same_sweep_again_trains_what_is_missing_alone(
    sweep: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = written_at(sweep)
    assert main(["train", "-m", *SMALL, "seed=0,1,2", "run.dir=sweep"]) == 0
    assert capsys.readouterr().out.count("done before") == 2
    after = written_at(sweep)
    assert {name: after[name] for name in before} == before
    assert summary(sweep / "2")["seed"] == 2


def test_a_run_of_a_sweep_that_was_stopped_goes_on_to_the_same_bits(
    ended: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def stopped(config: Config, folder: RunFolder, *rest: Any) -> dict[str, Any]:
        folder.stop_file.touch()
        return local.train(config, folder, *rest)

    small = [*SMALL, "state.every=1", "seed=0,1"]
    with monkeypatch.context() as patch:
        patch.setitem(runner.RUNTIMES, "local", stopped)
        assert main(["train", "-m", *small, "run.dir=sweep"]) == 0
    assert summary(tmp_path / "sweep" / "1")["ticks"] == 10
    capsys.readouterr()
    assert main(["train", "-m", *small, "run.dir=sweep"]) == 0
    assert capsys.readouterr().out.count("going on from window 1") == 2
    for number in ("0", "1"):
        assert summary(tmp_path / "sweep" / number)["digest"] == summary(ended / number)["digest"]


def test_a_run_that_never_reached_a_checkpoint_begins_again(sweep: Path) -> None:
    first = summary(sweep / "0")["digest"]
    for path in sorted((sweep / "0").rglob("*"), reverse=True):
        if path.is_file() and path.name != "config.yaml":
            path.unlink()
    assert main([*AGAIN]) == 0
    assert summary(sweep / "0")["digest"] == first


def test_a_run_that_is_going_on_elsewhere_is_left_alone(
    sweep: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (sweep / "0" / "summary.json").unlink()
    before = {path: path.stat().st_mtime_ns for path in sweep.rglob("*")}
    with run_lock(sweep / "0"):  # as another process holds it
        for launcher in ([], [JOBLIB]):
            assert main([*AGAIN, *launcher]) == 2
            assert "allowed is a folder in which no run is going on" in capsys.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in sweep.rglob("*")} == before


def test_a_run_with_results_and_no_checkpoint_is_not_trained_over(
    sweep: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    weights = (sweep / "0" / "weights.safetensors").read_bytes()
    shutil.rmtree(sweep / "0" / "state")
    for launcher in ([], [JOBLIB]):
        assert main([*AGAIN, "train.max_ticks=40", *launcher]) == 2
        assert "a checkpoint to go on from" in capsys.readouterr().err
    assert (sweep / "0" / "weights.safetensors").read_bytes() == weights


@pytest.mark.parametrize("text", ["{", "{}", "[]", '{"episodes": null, "ticks": 1}'])
def test_a_damaged_summary_is_said_in_a_sentence(
    sweep: Path, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    (sweep / "1" / "summary.json").write_text(text)
    assert main([*AGAIN]) == 2
    assert "a folder whose summary.json is whole" in capsys.readouterr().err


def test_a_file_in_the_place_of_a_run_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "sweep").mkdir()
    (tmp_path / "sweep" / "0").touch()
    assert main([*AGAIN]) == 2
    assert "new or empty, or of this sweep" in capsys.readouterr().err


def test_a_damaged_run_of_a_sweep_is_refused_and_kept(
    sweep: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    weights = sweep / "1" / "weights.safetensors"
    weights.write_bytes(b"damaged")
    assert main([*AGAIN]) == 2
    assert "a folder whose run is whole and of this version" in capsys.readouterr().err
    assert weights.read_bytes() == b"damaged"


def test_one_folder_holds_a_sweep_whatever_its_values(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["train", "-m", *SMALL, "seed=0,1", "run.dir=runs/${seed}"]) == 2
    assert "allowed is one folder for the whole sweep" in capsys.readouterr().err


# --- Launchers ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_launcher_takes_any_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sweep = tmp_path / "it's, [my] {sweep} ü=1"
    assert main(["train", "-m", JOBLIB, *SMALL, "seed=0,1", f"run.dir={sweep}"]) == 0
    assert f"sweep folder: {sweep}" in capsys.readouterr().out
    assert list(written_at(sweep)) == ["0", "1"]


@pytest.mark.slow
def test_a_sweep_on_every_core_has_the_status_of_its_worst_run(
    tmp_path: Path, start: Start
) -> None:
    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))  # too little for weights

    options = [*SMALL, "agent.hidden=[64,64]", "env.robots=1,2", "run.dir=sweep"]
    process = start("-m", JOBLIB, *options, preexec_fn=limited, cwd=tmp_path)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1, errors
    assert errors.count(" failed: ") == 2
    assert "File too large" in errors


@pytest.mark.parametrize(
    ("number", "status"),
    [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)],
)
def test_a_signal_ends_runs_on_every_core_with_what_they_have_learned(
    tmp_path: Path, start: Start, number: signal.Signals, status: int
) -> None:
    process = start(
        "-m", JOBLIB, *ENDLESS, "seed=0,1", "run.dir=sweep", cwd=tmp_path, start_new_session=True
    )
    folders = [tmp_path / "sweep" / name for name in ("0", "1")]
    wait_for(process, lambda: all(map(is_training, folders)))
    os.killpg(process.pid, number)  # as a terminal and as a batch system do
    printed, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == status, errors
    assert "To go on: the same command with run.dir=" in printed
    assert [summary(folder)["stopped_early"] for folder in folders] == [True, True]
    states = [json.loads((folder / "progress.json").read_text())["state"] for folder in folders]
    assert states == ["done", "done"]
    assert not list(tmp_path.rglob("stop"))
