"""A run that died goes on from its last whole checkpoint, to the bits of one that did not."""

from __future__ import annotations

import fcntl
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from resume_helpers import check_goes_on, check_same, rewound, summary

from conf.user_paths import resumed_folder
from experiments.cli import main
from storage.checkpoint_files import checkpoints
from storage.checkpoint_layout import robot_windows, server_folder
from training import checkpoint, resume
from training.recording import summary as accounts

FALLING = ("agent.learning_rate_end=0.001", "agent.learning_rate_updates=60")
EVERY_OPTION = (*FALLING, "agent.updates=2", "agent.double=true")
SERVING = (
    "env.reward.credit=difference",
    "env.reward.weights=objective",
    "env.state.others=1",
    "env.state.way=on",
    "env.state.weights=true",
    "env.state.order=gain",
)
CHANGES = ("train.max_ticks=120", "state.every=3", "evaluation.every=2", "evaluation.episodes=2")


def slow(*values: object) -> Any:
    """A case that is like one of its neighbours: left to ``make test-all``."""
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.fixture(scope="session")
def run_of_120_ticks(tiny_overrides: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run that nothing happens to, trained once; not to be changed."""
    folder: Path = tmp_path_factory.mktemp("resume") / "run"
    assert main(["train", *tiny_overrides, *CHANGES, f"run.dir={folder}"]) == 0
    return folder


@pytest.fixture
def train(tiny_overrides: list[str], tmp_path: Path, run_of_120_ticks: Path) -> Callable[..., Path]:
    """Trains the tiny fleet from the command line, into a folder of this name.

    Without changes the run is a copy of the one that was trained once.
    """

    def run(name: str, *changes: str) -> Path:
        folder = tmp_path / name
        if not changes:
            shutil.copytree(run_of_120_ticks, folder)
            return folder
        assert main(["train", *tiny_overrides, *CHANGES, *changes, f"run.dir={folder}"]) == 0
        return folder

    return run


def die_at(monkeypatch: pytest.MonkeyPatch, window: int) -> None:
    """Lets a run fail before the server writes its checkpoint of a window."""
    save = accounts.save_server  # type: ignore[attr-defined]

    def fatal(writer, state, at, *rest):
        if at == window:
            raise OSError("the machine is gone")
        save(writer, state, at, *rest)

    monkeypatch.setattr(accounts, "save_server", fatal)


def test_a_run_that_died_ends_in_the_same_bits(
    train, tmp_path, tiny_overrides, monkeypatch
) -> None:
    whole, folder = train("whole"), tmp_path / "died"
    with monkeypatch.context() as patch:
        die_at(patch, 9)
        assert main(["train", *tiny_overrides, *CHANGES, f"run.dir={folder}"]) == 1
    assert checkpoints(server_folder(folder / "state")) == [3, 6]
    assert main(["train", f"resume={folder}"]) == 0
    check_same(folder, whole)


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
    """It is killed when it has written two checkpoints, wherever it is by then."""
    endless = ("train.max_ticks=100000000", "train.episodes=100000000", "evaluation.every=50")
    folder = tmp_path / "killed"
    command = [sys.executable, "-m", "experiments.cli", "train", *tiny_overrides, *CHANGES]
    process = subprocess.Popen(
        [*command, *endless, f"run.dir={folder}"],
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )
    deadline = time.monotonic() + 300
    while len(checkpoints(server_folder(folder / "state"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert not (folder / "summary.json").exists()
    length = f"train.max_ticks={10 * checkpoint.latest(folder / 'state', 3).window + 25}"
    whole = train("whole", *endless, length)
    assert main(["train", f"resume={folder}", length]) == 0
    check_same(folder, whole)


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
    monkeypatch.setattr("training.resume.fingerprint", lambda env: "another")
    assert main(["train", f"resume={folder}", "train.max_ticks=500"]) == 2
    assert "allowed is a run of this version" in capsys.readouterr().err


def test_without_checkpoints_none_are_written(train) -> None:
    folder = train("bare", "state.every=null", "train.max_ticks=20")
    assert not (folder / "state").exists()


def test_a_run_that_died_after_its_last_window_is_finished_without_playing(train) -> None:
    for strategy in ("fedavg", "none"):
        folder = train(strategy, *() if strategy == "fedavg" else ("strategy=none",))
        before = summary(folder)
        (folder / "summary.json").unlink()
        (folder / "weights.safetensors").unlink()
        assert main(["train", f"resume={folder}"]) == 0
        for key in ("digest", "ticks", "evaluation"):
            assert summary(folder)[key] == before[key]
        assert (folder / "weights.safetensors").exists()


def test_robots_a_write_ahead_of_the_server_leave_a_checkpoint_that_all_have(
    train, tiny_overrides, tmp_path, monkeypatch
) -> None:
    """The server's disk stalls from window 6 on, until the run dies at window 12."""
    whole, folder = train("whole"), tmp_path / "stalled"

    def stalled(writer, state, window, *rest):
        if window >= 9:
            raise OSError("the machine is gone")
        if window == 3:
            save(writer, state, window, *rest)

    save = accounts.save_server  # type: ignore[attr-defined]
    with monkeypatch.context() as patch:
        patch.setattr(accounts, "save_server", stalled)
        given = ["train", *tiny_overrides, *CHANGES, f"run.dir={folder}"]
        assert main(given) == 1
    assert sorted(robot_windows(folder / "state", 0)) == [3, 6, 9]
    assert main(["train", f"resume={folder}"]) == 0
    assert summary(folder)["digest"] == summary(whole)["digest"]


def test_files_that_lack_rows_are_refused_before_anything_is_written(train, capsys) -> None:
    folder = train("ended")
    text = (folder / "metrics.csv").read_text()
    (folder / "metrics.csv").write_text(text.splitlines()[0] + "\n")
    before = (folder / "config.yaml").read_text()
    assert main(["train", f"resume={folder}", "train.max_ticks=500"]) == 2
    assert "metrics.csv has 0 rows" in capsys.readouterr().err
    assert (folder / "config.yaml").read_text() == before


def test_files_that_an_editor_saved_in_its_own_way_go_on_to_the_same_bits(train, tmp_path) -> None:
    whole = train("whole")
    folder = rewound(whole, tmp_path / "edited", 6)
    for name in ("config.yaml", "metrics.csv", "evaluations.csv"):
        text = (folder / name).read_text(encoding="utf-8")
        (folder / name).write_text(text, encoding="utf-8-sig", newline="\r\n")
    assert main(["train", f"resume={folder}"]) == 0
    check_same(folder, whole)


def test_a_configuration_in_utf_16_is_named(train, capsys) -> None:
    folder = train("ended")
    path = folder / "config.yaml"
    path.write_text(path.read_text(encoding="utf-8"), encoding="utf-16")
    assert main(["train", f"resume={folder}", "train.max_ticks=500"]) == 2
    said = "config.yaml cannot be read: it is in UTF-16: save it as UTF-8.\n"
    assert capsys.readouterr().err.endswith(said)


def test_a_run_that_is_going_on_is_not_joined(train, capsys) -> None:
    folder = train("ended")
    handle = os.open(folder, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        assert main(["train", f"resume={folder}", "train.max_ticks=500"]) == 2
    finally:
        os.close(handle)
    assert "a folder in which no run is going on" in capsys.readouterr().err
    assert summary(folder)["ticks"] == 120


@pytest.mark.parametrize(
    "changes",
    [
        slow(["env.channel.fading=slot"]),
        ["strategy=none"],
        ["strategy=fedprox", "strategy.proximal_mu=0.1"],
        ["env.ris.response=near", "env.ris.action=codebook", "env.ris.sectors=[2,2]"],
        slow(["env.collisions=block", "env.walls.block_motion=true", "env.reward.distance=way"]),
        ["strategy=krum", "env.access=oma", "env.metric=qoe"],
        slow(["baseline=centralized", "env.robots=2"]),
        slow(["baseline=branching"]),
        ["baseline=branching", "scheme.heads=shared", "agent.double=true"],
        slow(["baseline=random_phase"]),
        ["baseline=oracle_phase", "env.channel.fading=slot"],
        slow(["strategy=fedmedian"]),
        ["strategy=fedadam", *EVERY_OPTION],
        slow(["strategy=fedavgm"]),
        slow(["strategy=fedadam", "env.channel.fading=slot"]),
        ["baseline=centralized", "env.robots=2", *EVERY_OPTION],
        slow(["baseline=branching", "agent.updates=2", *FALLING]),
        slow(["train.worlds=3", "strategy=fedavgm", *SERVING]),
        ["train.worlds=2", "env.channel.fading=slot", *EVERY_OPTION],
        slow(["train.worlds=2", "env.channel.fading=slot", "scheme.power=search"]),
        slow(["baseline=centralized", "env.robots=2", "train.worlds=2"]),
        ["baseline=branching", "train.worlds=2", "env.channel.fading=slot"],
    ],
)
def test_other_worlds_strategies_and_schemes_are_resumed_to_the_same_bits(train, changes) -> None:
    check_goes_on(train("whole", *changes), 6)


def test_a_full_disk_ends_a_run_with_a_sentence(tiny_overrides, tmp_path, monkeypatch, capsys):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("storage.checkpoint_files.os.fsync", full)
    given = ["train", *tiny_overrides, *CHANGES, f"run.dir={tmp_path / 'full'}"]
    assert main(given) == 1
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith(f"risfleet: No space left on device: {tmp_path / 'full'}")


@pytest.mark.parametrize("folder", ["/tmp/my run", "/tmp/it's", "/tmp/lr=0.1 $HOME", "/tmp/plain"])
def test_how_to_go_on_can_be_pasted_into_a_shell(folder: str) -> None:
    command = shlex.split(resume.how(Path(folder)))
    assert command[:2] == ["risfleet", "train"]
    assert resumed_folder(command[2]) == Path(folder)
