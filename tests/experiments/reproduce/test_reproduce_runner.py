"""The runner of ``risfleet reproduce``: what it skips, resumes, starts anew, and how it fails."""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from reproduce_helpers import without_a_targets_own
from rich.console import Console

from conf import Config, ConfigError
from experiments.batch.states import State, folder_of, state_of
from experiments.batch.train import BatchOutcome
from experiments.cli import main
from experiments.reproduce.runner import Plan, train
from experiments.reproduce.targets.plan import Cell
from experiments.runtimes import local, runner
from experiments.runtimes.folders import folder_lock
from training.run_folder import RunFolder

HERE = ["hydra/launcher=basic"]
"""Jobs in this process, one after the other."""

PATIENCE_S = 300.0


@pytest.fixture(scope="module")
def overrides(tiny_overrides: tuple[str, ...]) -> list[str]:
    """The tiny task without what a target sets itself; checkpoints at every second window."""
    return [*without_a_targets_own(tiny_overrides), "train.max_ticks=40", "state.every=2"]


def planned(overrides: Sequence[str], out: Path, seeds: tuple[int, ...] = (10, 11)) -> Plan:
    """Seeds of one cell."""
    return Plan([Cell("tiny", tuple(overrides), seeds)], out)


@pytest.fixture
def plan(overrides: list[str], tmp_path: Path) -> Plan:
    """A plan of which nothing is trained."""
    return planned(overrides, tmp_path / "out")


@pytest.fixture(scope="module")
def first_call(
    overrides: list[str], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Plan, BatchOutcome, str]:
    """A plan that was trained without a stop, its outcome, and what was said; not to be changed."""
    plan = planned(overrides, tmp_path_factory.mktemp("straight"))
    return plan, *trained(plan)


@pytest.fixture(scope="module")
def straight(first_call: tuple[Plan, BatchOutcome, str]) -> Plan:
    return first_call[0]


@pytest.fixture
def done(straight: Plan, plan: Plan) -> Plan:
    """A plan of which everything is trained."""
    shutil.copytree(straight.store, plan.store)
    return plan


def trained(plan: Plan) -> tuple[BatchOutcome, str]:
    said = io.StringIO()
    return train(plan, 1, HERE, Console(file=said, width=300)), said.getvalue()


def digests(plan: Plan) -> list[dict[str, str]]:
    return [json.loads((f / "summary.json").read_text())["digest"] for f in plan.configs]


def spoilt(monkeypatch: pytest.MonkeyPatch, seed: int, spoil: Callable[[Path], None]) -> list[int]:
    """Spoils the run of one seed as it begins; returns the list of the seeds that begin."""
    begun: list[int] = []
    real = local.train

    def spoilt_train(config: Config, folder: RunFolder, *rest: Any) -> dict[str, Any]:
        begun.append(config.seed)
        if config.seed == seed:
            spoil(folder.path)
        return real(config, folder, *rest)

    monkeypatch.setitem(runner.RUNTIMES, "local", spoilt_train)
    return begun


def test_everything_is_trained_where_nothing_is_done(
    first_call: tuple[Plan, BatchOutcome, str],
) -> None:
    plan, outcome, said = first_call
    assert "2 runs to train, 0 done before" in said
    assert set(outcome.done) == set(plan.configs)


def test_what_is_done_is_not_trained_again(done: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    begun = spoilt(monkeypatch, 99, lambda folder: None)
    outcome, said = trained(done)
    assert (begun, said) == ([], "")
    assert len(outcome.done) == 2


def test_a_run_has_the_bits_that_risfleet_train_gives(
    straight: Plan, overrides: list[str], tmp_path: Path
) -> None:
    same = ["runtime=local", "run.figures=false", "run.tensorboard=false", "seed=11"]
    assert main(["train", *overrides, *same, f"run.dir={tmp_path / 'alone'}"]) == 0
    alone = json.loads((tmp_path / "alone" / "summary.json").read_text())
    assert digests(straight)[1] == alone["digest"]


def test_a_run_that_was_stopped_goes_on_to_the_same_bits(plan: Plan, straight: Plan) -> None:
    with pytest.MonkeyPatch.context() as patch:
        spoilt(patch, 10, lambda folder: (folder / "stop").touch())
        outcome, _ = trained(plan)
    first, second = plan.configs.values()
    assert (state_of(first), state_of(second)) == (State.BEGUN, State.DONE)
    assert list(outcome.failed) == [folder_of(first)]
    (folder_of(first) / "stop").unlink(missing_ok=True)
    outcome, said = trained(plan)
    assert "1 runs to train, 1 done before" in said
    assert not outcome.failed
    assert digests(plan) == digests(straight)


@pytest.mark.parametrize(
    "damage",
    [
        "weights.safetensors",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("summary.json", "evaluations.csv")
        ),
    ],
)
def test_a_damaged_run_is_trained_again(damage: str, done: Plan) -> None:
    first = next(iter(done.configs.values()))
    folder = folder_of(first)
    (folder / damage).write_text("{")
    for checkpoint in (folder / "state").rglob("*.safetensors"):
        checkpoint.write_bytes(b"")
    if damage == "evaluations.csv":
        (folder / damage).unlink()
    assert state_of(first) is State.NEW
    (folder / "of an earlier time").touch()
    trained(done)
    assert state_of(first) is State.DONE
    assert not (folder / "of an earlier time").exists()


def test_an_empty_folder_is_a_run_that_never_began(plan: Plan) -> None:
    first = next(iter(plan.configs.values()))
    folder_of(first).mkdir(parents=True)
    assert state_of(first) is State.NEW


def test_a_run_that_fails_says_why_and_the_others_go_on(
    plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(folder: Path) -> None:
        raise OSError("the disk is full")

    begun = spoilt(monkeypatch, 10, fail)
    outcome, _ = trained(plan)
    first, second = plan.configs
    assert begun == [10, 11]
    assert outcome.done == (second,)
    assert outcome.failed == {first: "OSError: the disk is full"}


def test_jobs_are_launched_again_where_their_launcher_broke(
    overrides: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from hydra._internal.core_plugins.basic_launcher import BasicLauncher

    calls: list[int] = []
    real = BasicLauncher.launch

    def launch(self: Any, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Any:
        calls.append(len(job_overrides))
        if len(calls) == 1:
            raise RuntimeError("a process was killed")
        return real(self, job_overrides, initial_job_idx)

    monkeypatch.setattr(BasicLauncher, "launch", launch)
    outcome, said = trained(planned(overrides, tmp_path, (10,)))
    assert "RuntimeError: a process was killed" in said
    assert len(calls) == 2
    assert not outcome.failed


def test_two_calls_do_not_train_in_one_folder(plan: Plan) -> None:
    plan.store.mkdir(parents=True)
    other = folder_lock(plan.store, ("--out", plan.store, "another"))
    with other, pytest.raises(ConfigError, match="nothing is being reproduced"):
        trained(plan)


# --- The command ----------------------------------------------------------------------------------


def test_help_says_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["reproduce", "--help"])
    assert end.value.code == 0
    assert "fig3" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["fig9"], "'fig9' is no target: allowed is one of fig3"),
        (["fig3", "env.robot=2"], "env.robot is no key"),
        (["fig3", "env.power.levels=1"], "env.power.levels=1"),
        (["fig3", "seed=3"], "seed is the target's own"),
        (["fig3", "run.figures=true"], "run.figures is the target's own"),
        (["fig3", "runtime=simulation"], "runtime is the target's own"),
        (["fig3", "--quick", "hydra/launcher=nowhere"], "hydra/launcher"),
        (["fig3", "hydra/launcher=basic", "--jobs", "2"], "--jobs 2"),
    ],
)
def test_a_mistake_is_refused_before_anything_starts(
    arguments: list[str],
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["reproduce", *arguments]) == 2
    assert sentence in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_ctrl_c_ends_all_runs_and_leaves_no_process_behind(
    overrides: list[str], tmp_path: Path
) -> None:
    endless = [item for item in overrides if not item.startswith("train.")]
    command = [sys.executable, "-m", "experiments.cli", "reproduce", "fig3", "--quick"]
    options = ["--jobs", "2", "train.episodes=100000", *endless]
    process = subprocess.Popen(
        [*command, *options],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    store = tmp_path / "reproduce-quick" / "runs"
    try:
        assert process.stdout is not None
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            if sum(p.stat().st_size > 200 for p in store.glob("*/*/metrics.csv")) >= 2:
                break
            time.sleep(0.1)
        os.killpg(process.pid, signal.SIGINT)
        said, _ = process.communicate(timeout=PATIENCE_S)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 130, said
    assert "the same call goes on" in said
    summaries = [json.loads(path.read_text()) for path in store.glob("*/*/summary.json")]
    assert [each["stopped_early"] for each in summaries] == [True, True]
    assert not list(store.rglob("stop"))
    until = time.monotonic() + PATIENCE_S
    while (left := alive(process.pid)) and time.monotonic() < until:
        time.sleep(0.1)  # the launcher's own helpers end a moment later
    assert not left


def alive(session: int) -> list[str]:
    """Names of the processes of a session that have not ended."""
    names = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            name, rest = path.read_text().rsplit(")", 1)
            state, *numbers = rest.split()
            if int(numbers[2]) == session and state != "Z":
                names.append(name)
    return names
