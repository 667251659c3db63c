"""``import risfleet``: trains, loads, evaluates and sweeps as the command does."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import risfleet
from experiments.cli import main
from experiments.console import display
from experiments.runtimes import local, runner
from training.run_folder import RunFolder

ROOT = Path(__file__).parents[2]
ENDLESS = ("train.max_ticks=null", "train.episodes=100000000")


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(display, "POLL_S", 0.02)


@pytest.fixture
def tiny_list(tiny_overrides: tuple[str, ...]) -> list[str]:
    """The tiny task, a few ticks of it."""
    return [*tiny_overrides, "train.max_ticks=30"]


# --- The names ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", risfleet.__all__)
def test_every_name_that_is_stable_is_there_and_listed(name: str) -> None:
    assert getattr(risfleet, name)
    assert name in dir(risfleet)


def test_importing_it_loads_nothing_else() -> None:
    heavy = ("numpy", "gymnasium", "hydra", "torch", "flwr", "matplotlib", "rich", "pandas")
    program = f"import sys, risfleet; print([m for m in {heavy!r} if m in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", program], text=True).strip() == "[]"


def test_a_package_that_hides_one_of_ours_is_named(tmp_path: Path) -> None:
    (tmp_path / "agent.py").touch()
    done = subprocess.run(
        [sys.executable, "-c", "import risfleet; risfleet.load"],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "agent.py hides the package agent of RISFleet" in done.stderr


def test_the_module_is_the_command() -> None:
    command = [sys.executable, "-m", "risfleet", "--version"]
    said = subprocess.check_output(command, text=True)
    assert said == f"risfleet {risfleet.__version__}\n"


# --- Training -------------------------------------------------------------------------------------


def test_it_trains_what_the_command_trains(
    tiny_list: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    run = risfleet.train([*tiny_list, "run.dir=mine"], progress=False)
    assert capsys.readouterr() == ("", "")
    assert main(["train", *tiny_list, "run.dir=theirs"]) == 0
    other = risfleet.load("theirs")
    assert run.summary["digest"] == other.summary["digest"]
    assert run.path == Path("mine").absolute()
    assert not run.stopped_early
    assert run.config.train == other.config.train


@pytest.mark.parametrize(
    "mistake",
    [
        "env.robots=0",
        "env.robtos=3",
        "seed=0,1",
        "baseline=shortest_canonical",
        "resume=nowhere",
        "env.reward.model=nobodys",
        "run.dir=used",
    ],
)
def test_a_mistake_is_the_commands_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], mistake: str
) -> None:
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "file").touch()
    assert main(["train", mistake]) == 2
    said = capsys.readouterr().err
    with pytest.raises(ValueError, match=r".") as refused:
        risfleet.train(mistake)
    assert f"risfleet: {refused.value}\n" == said
    assert [path.name for path in tmp_path.iterdir()] == ["used"]


def test_it_trains_in_a_thread_and_beside_a_running_loop(tiny_list: list[str]) -> None:
    found: dict[str, Any] = {}

    def train(name: str) -> None:
        found[name] = risfleet.train([*tiny_list, f"run.dir={name}"], progress=False).summary

    async def cell() -> None:
        train("loop")

    thread = threading.Thread(target=train, args=["thread"])
    thread.start()
    thread.join()
    asyncio.run(cell())
    assert found["thread"]["digest"] == found["loop"]["digest"]


def test_progress_is_told_to_a_function_or_shown_as_by_the_command(
    tiny_list: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    told: list[dict[str, Any]] = []
    risfleet.train([*tiny_list, "run.dir=told"], progress=told.append)
    assert capsys.readouterr() == ("", "")
    assert (told[-1]["state"], told[-1]["tick"]) == ("done", 30)
    risfleet.train([*tiny_list, "run.dir=shown"])
    mine = capsys.readouterr().out.splitlines()
    assert mine[0].endswith(str(Path("shown").absolute()))
    assert any("last 5 in training" in line for line in mine)


def stop_by(number: signal.Signals) -> Callable[[dict[str, Any]], None]:
    """Sends a signal once, when the run has begun to learn."""
    sent: list[int] = []

    def tell(status: dict[str, Any]) -> None:
        if status["tick"] and not sent:
            sent.append(number)
            os.kill(os.getpid(), number)

    return tell


def test_an_interrupt_keeps_what_was_learned_and_a_resume_goes_on(tiny_list: list[str]) -> None:
    begun = [*tiny_list, *ENDLESS, "state.every=1", "run.dir=run"]
    before = signal.getsignal(signal.SIGINT)  # whoever runs tests in the background ignores it
    run = risfleet.train(begun, progress=stop_by(signal.SIGINT))
    assert run.stopped_early
    assert signal.getsignal(signal.SIGINT) is before
    ticks = run.summary["ticks"]
    again = {"resume": run.path, "train.max_ticks": ticks + 20}
    assert risfleet.train(again, progress=False).summary["ticks"] == ticks + 20
    assert not run.stopped_early


def test_sigterm_ends_the_run_and_then_what_it_would_have_ended(tiny_list: list[str]) -> None:
    passed: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, frame: passed.append(number))
    try:
        begun = [*tiny_list, *ENDLESS, "run.dir=run"]
        assert risfleet.train(begun, progress=stop_by(signal.SIGTERM)).stopped_early
    finally:
        signal.signal(signal.SIGTERM, before)
    assert passed == [signal.SIGTERM]


# --- Runs -----------------------------------------------------------------------------------------


def test_metrics_are_a_frame_or_columns(tiny_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = risfleet.load(tiny_run)
    header, *rows = (tiny_run / "metrics.csv").read_text().splitlines()
    framed = run.metrics
    monkeypatch.setitem(sys.modules, "pandas", None)
    columns = run.metrics
    assert list(framed) == list(columns) == header.split(",")
    assert columns["tick"].dtype == np.int64
    for place, name in enumerate(columns):
        values = [float(row.split(",")[place]) for row in rows]
        np.testing.assert_array_equal(columns[name], values)
        np.testing.assert_array_equal(framed[name], values)
    assert set(run.evaluations["epsilon"]) == {0.0, 0.05}


def test_a_row_that_is_still_written_is_left_out(tiny_run: Path, tmp_path: Path) -> None:
    for name in ("config.yaml", "metrics.csv"):
        (tmp_path / name).write_bytes((tiny_run / name).read_bytes())
    with (tmp_path / "metrics.csv").open("a") as file:
        file.write("99,12")
    kept = risfleet.load(tmp_path).metrics
    assert len(kept["episode"]) == len(risfleet.load(tiny_run).metrics["episode"])


def test_what_is_not_there_yet_is_said(tiny_run: Path, tmp_path: Path) -> None:
    with pytest.raises(risfleet.ConfigError, match="is no run folder"):
        risfleet.load(tmp_path)
    (tmp_path / "config.yaml").write_bytes((tiny_run / "config.yaml").read_bytes())
    run = risfleet.load(tmp_path)
    for ask in (lambda: run.summary, lambda: run.policy):
        with pytest.raises(risfleet.ConfigError, match="has the run ended"):
            ask()
    with pytest.raises(risfleet.ConfigError, match=r"No such file .*metrics.csv"):
        _ = run.metrics
    assert run._repr_html_() is None


def test_a_run_shows_its_folder_and_its_measures(tiny_run: Path) -> None:
    run = risfleet.load(tiny_run)
    assert repr(run) == f"<Run {tiny_run}>"
    html = run._repr_html_()
    assert html is not None
    assert "success" in html
    assert str(tiny_run) not in html


def test_an_evaluation_is_the_commands(tiny_run: Path) -> None:
    command = ["evaluate", str(tiny_run), "--episodes", "5", "--seed", "7", "--json", "e.json"]
    assert main([*command, "--epsilon", "0", "--epsilon", "0.5"]) == 0
    theirs = json.loads(Path("e.json").read_text())
    for epsilon in (0, 0.5):
        mine = risfleet.load(tiny_run).evaluate(episodes=5, seed=7, epsilon=epsilon)
        assert mine.success == theirs[f"eps = {epsilon:g}"]["success"]
        assert mine.ee == theirs[f"eps = {epsilon:g}"]["ee"]
        assert mine.episodes is not None
        assert mine.episodes.success.shape == (5,)


@pytest.mark.parametrize(
    ("option", "sentence"),
    [
        ({"episodes": 0}, "episodes=0: allowed is a whole number of at least 1."),
        ({"episodes": 2.5}, "episodes=2.5: allowed is a whole number of at least 1."),
        ({"epsilon": 2}, "epsilon=2: allowed is a number from 0 to 1."),
        ({"epsilon": (0, 0.1)}, "allowed is a number from 0 to 1."),
        ({"seed": -1}, "seed=-1: allowed is a whole number of at least 0."),
    ],
)
def test_an_option_that_cannot_be_is_refused(
    tiny_run: Path, option: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(risfleet.ConfigError) as refused:
        risfleet.load(tiny_run).evaluate(**option)
    assert str(refused.value).endswith(sentence)


def test_what_learns_nothing_is_evaluated_by_its_overrides(tiny_overrides: tuple[str, ...]) -> None:
    rule = [*tiny_overrides, "baseline=shortest_canonical"]
    found = risfleet.evaluate(rule, episodes=3)
    assert (found.success, found.path_ratio) == (1.0, 1.0)
    with pytest.raises(risfleet.ConfigError, match="allowed without a run's folder"):
        risfleet.evaluate(tiny_overrides)


def test_a_building_is_its_rooms(building_run: Path) -> None:
    run = risfleet.load(building_run)
    command = ["evaluate", str(building_run), "--episodes", "2", "--json", "e.json"]
    assert main(command) == 0
    theirs = json.loads(Path("e.json").read_text())
    mine = run.evaluate_rooms(episodes=2)
    assert {name: one.reward for name, one in mine.items()} == {
        name: one["reward"] for name, one in theirs.items()
    }
    assert len(run.rooms) == 4
    for room in run.rooms.values():
        assert room.evaluate(episodes=1).episodes is not None
    for ask in (run.evaluate, lambda: run.policy):
        with pytest.raises(risfleet.ConfigError, match="allowed is"):
            ask()
    with pytest.raises(risfleet.ConfigError, match="has no rooms"):
        next(iter(run.rooms.values())).evaluate_rooms()


# --- Sweeps ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("jobs", "launcher"),
    [(None, ["hydra/launcher=basic"]), pytest.param(2, [], marks=pytest.mark.slow)],
)
def test_a_sweep_gives_what_single_runs_give(
    tiny_list: list[str], jobs: int | None, launcher: list[str]
) -> None:
    grid = {"strategy": ["fedavg", "none"]}
    common = [*tiny_list, *launcher, "run.dir=sweep"]
    runs = risfleet.sweep(common, grid, jobs=jobs, progress=False)
    assert [run.config.strategy.name for run in runs] == ["fedavg", "none"]
    single = risfleet.train([*tiny_list, "strategy=none", "run.dir=single"], progress=False)
    assert runs[1].summary["digest"] == single.summary["digest"]
    written = runs[0].summary
    again = risfleet.sweep([*tiny_list, "run.dir=sweep"], grid, jobs=1, progress=False)
    assert [run.path for run in again] == [run.path for run in runs]
    assert again[0].summary == written


def test_a_mistake_in_any_combination_starts_none(tiny_list: list[str], tmp_path: Path) -> None:
    with pytest.raises(risfleet.ConfigError, match=r"env\.robots=0"):
        risfleet.sweep(tiny_list, {"env.robots": [3, 0]})
    with pytest.raises(risfleet.ConfigError, match="jobs=0: allowed is None or a whole number"):
        risfleet.sweep(tiny_list, jobs=0)
    assert list(tmp_path.iterdir()) == []


def test_runs_of_a_sweep_that_fail_are_named_and_the_others_are_there(
    tiny_list: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail_once(config: Any, folder: RunFolder, resumed: Any) -> dict[str, Any]:
        if config.seed == 3:
            raise OSError("no disk")
        return local.train(config, folder, resumed)

    monkeypatch.setitem(runner.RUNTIMES, "local", fail_once)
    with pytest.raises(risfleet.SweepError, match="no disk") as failed:
        risfleet.sweep(tiny_list, {"seed": [3, 4]}, jobs=1, progress=False)
    assert [run.config.seed for run in failed.value.runs] == [4]
    assert [folder.name for folder in failed.value.failed] == ["0"]
    assert capsys.readouterr() == ("", "")
