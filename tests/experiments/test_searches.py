"""``risfleet train -m hydra/sweeper=optuna``: runs in turn, each chosen by what others reached."""

from __future__ import annotations

import re
import signal
from pathlib import Path

import pytest
from omegaconf import OmegaConf
from rich.console import Console
from train_helpers import SMALL, summary

from experiments.batch import search
from experiments.cli import main
from experiments.runtimes.stopping import StopSignals
from training.run_folder import RunFolder

OPTUNA = ("hydra/sweeper=optuna", "hydra.sweeper.n_trials=2", "run.dir=sweep")
RATE = "agent.learning_rate=tag(log,interval(0.0001,0.01))"


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
def test_optuna_chooses_values_and_the_same_command_finds_their_runs_done(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("optuna")
    command = ["train", "-m", *OPTUNA, *SMALL, RATE, "strategy=fedavg,none", "--objective"]
    assert main([*command, "eps05.sum_rate"]) == 0
    printed = capsys.readouterr().out
    runs = [RunFolder(tmp_path / "sweep" / str(number)) for number in range(2)]
    reached = [summary(run.path)["evaluation"]["eps05"]["sum_rate"] for run in runs]
    rates = [run.read_config().agent.learning_rate for run in runs]
    assert len({*rates}) == 2
    assert all(0.0001 <= rate <= 0.01 for rate in rates)
    found = OmegaConf.load(tmp_path / "sweep" / "optimization_results.yaml")
    assert found.best_value == max(reached)
    best = runs[reached.index(max(reached))].read_config()
    assert found.best_params["agent.learning_rate"] == best.agent.learning_rate
    assert found.best_params["strategy"] == best.strategy.name
    assert f"best: eps05.sum_rate is {max(reached):.6g} with agent.learning_rate=" in printed
    before = [run.summary_file.stat().st_mtime_ns for run in runs]
    assert main([*command, "eps05.sum_rate"]) == 0
    assert [run.summary_file.stat().st_mtime_ns for run in runs] == before
    assert capsys.readouterr().out.count("done before") == 2


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((*OPTUNA, RATE, "--objective", "luck"), "--objective luck: allowed is one of success, ee"),
        ((*OPTUNA, RATE, "--objective", "last9.ee"), "with one of greedy, eps05, last5, last5_gre"),
        ((RATE, "--objective", "ee"), "allowed with hydra/sweeper=NAME, which chooses"),
        (("seed=0,1", "hydra.sweeper.n_trials=3"), "allowed with hydra/sweeper=NAME"),
        (("hydra/sweeper=nope", "seed=0,1"), "Could not find 'hydra/sweeper/nope'"),
        ((*OPTUNA, "seed=1"), "hydra/sweeper: allowed with values to choose from, as in agent."),
        ((*OPTUNA, RATE, "hydra/launcher=joblib"), "hydra/launcher: allowed is none with hydra/sw"),
        ((*OPTUNA, RATE, "env.robots=99"), "env.robots=99: allowed is a number from 1 to 64"),
        ((*OPTUNA, RATE, "hydra.job.name=x"), "and hydra/sweeper=NAME and hydra.sweeper.KEY: no"),
        (("hydra/sweeper=optuna,basic", RATE), "allowed is one launcher or sweeper for all runs"),
    ],
)
def test_mistakes_are_said_before_a_folder_is_made(
    arguments: tuple[str, ...],
    says: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["train", "-m", *SMALL, *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line
    assert [*tmp_path.iterdir()] == []


def test_an_objective_without_a_sweep_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", *SMALL, "--objective", "ee"]) == 2
    assert "--objective ee: allowed with -m hydra/sweeper=NAME" in capsys.readouterr().err


def test_a_folder_of_something_else_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("optuna")
    (tmp_path / "sweep").mkdir()
    (tmp_path / "sweep" / "diary").touch()
    assert main(["train", "-m", *OPTUNA, *SMALL, RATE]) == 2
    assert "allowed is a folder that is new or empty, or of a sweep" in capsys.readouterr().err


@pytest.mark.parametrize("how", ["signal", "mistake"])
def test_a_run_that_does_not_end_ends_the_search(
    how: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("optuna")
    values = RATE
    if how == "signal":
        stop = StopSignals([], Console())
        stop.number = signal.SIGINT
        monkeypatch.setattr(search, "train_missing", lambda config: stop)
    else:
        values = "env.power.levels=choice(1,1)"  # two robots need two levels
    assert main(["train", "-m", *OPTUNA, *SMALL, values]) == (130 if how == "signal" else 2)
    printed = capfd.readouterr()
    assert len(re.findall(r"^run \d+:", printed.out, re.M)) == (1 if how == "signal" else 0)
    assert printed.err.count("\n") == (0 if how == "signal" else 1)
