"""Runs trained together end in what they come to one by one, each in its own folder."""

from __future__ import annotations

import csv
import json
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from safetensors.numpy import load_file

from conf import Config
from env.link import RobotFailed
from experiments import local, together
from experiments.cli import main
from experiments.together import Meter
from server_app import coordinator, session

Changed = Callable[..., Config]
SAME = ("digest", "ticks", "windows", "episodes", "stopped_early")
CONFIGURATIONS: dict[str, dict[str, Any]] = {
    "three robots": {},
    "one robot": {"env.robots": 1},
    "no aggregation": {"strategy.name": "none"},
    "one independent robot": {"env.robots": 1, "strategy.name": "none"},
    "server momentum": {"strategy.name": "fedavgm", "strategy.momentum": 0.5},
    "proximal, double, soft target": {
        "strategy.name": "fedprox",
        "strategy.proximal_mu": 0.5,
        "agent.double": True,
        "agent.target.tau": 0.05,
    },
    "an AP that looks ahead": {"agent.discount.ap": 0.9},
    "a channel that fades": {"env.channel.fading": "slot"},
    "destinations of their own": {"env.tasks.destination": "random"},
}


@pytest.fixture
def runs(tiny: Changed, tmp_path: Path) -> Callable[..., list[tuple[Config, Path]]]:
    """Tiny runs of several seeds, with folders below the one of this name."""

    def make(
        name: str, seeds: Sequence[int], changes: Mapping[str, Any] | None = None
    ) -> list[tuple[Config, Path]]:
        folders = [tmp_path / name / str(seed) for seed in seeds]
        return [
            (tiny({**(changes or {}), "seed": seed, "run.dir": str(folder)}), folder)
            for seed, folder in zip(seeds, folders, strict=True)
        ]

    return make


def summary(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return content


def rows(path: Path) -> list[dict[str, str]]:
    """A CSV file's rows without the clocks."""
    with path.open(newline="") as file:
        return [{k: v for k, v in row.items() if k != "cpu_s"} for row in csv.DictReader(file)]


def assert_same(found: Path, expected: Path) -> None:
    """Compares two runs' folders, clocks apart."""
    assert {path.name for path in found.iterdir()} == {path.name for path in expected.iterdir()}
    assert {k: summary(found)[k] for k in SAME} == {k: summary(expected)[k] for k in SAME}
    assert summary(found)["evaluation"] == summary(expected)["evaluation"]
    for name in ("metrics.csv", "evaluations.csv"):
        assert rows(found / name) == rows(expected / name)
        assert len(rows(found / name)) > 0
    ours, theirs = (load_file(folder / "weights.safetensors") for folder in (found, expected))
    assert {k: a.tobytes() for k, a in ours.items()} == {k: a.tobytes() for k, a in theirs.items()}


@pytest.mark.parametrize("changes", CONFIGURATIONS.values(), ids=CONFIGURATIONS)
def test_together_and_one_by_one_leave_the_same_behind(runs: Any, changes: dict[str, Any]) -> None:
    seeds = (3, 4, 7)
    side_by_side, alone = runs("together", seeds, changes), runs("alone", seeds, changes)
    endings = together.train(side_by_side)
    for ending, (_, folder), (config, own) in zip(endings, side_by_side, alone, strict=True):
        assert ending["digest"] == local.train(config, own)["digest"]
        assert_same(folder, own)
        assert summary(folder)["runs_together"] == 3
        assert summary(own)["runs_together"] == 1
    assert len({summary(folder)["digest"]["robots"] for _, folder in side_by_side}) == 3


def test_each_run_ends_when_its_own_end_has_come(runs: Any) -> None:
    changes = {"train.episodes": 7, "train.max_ticks": None}
    seeds = (0, 1, 2, 3)
    side_by_side, alone = runs("together", seeds, changes), runs("alone", seeds, changes)
    together.train(side_by_side)
    for (config, own), (_, folder) in zip(alone, side_by_side, strict=True):
        local.train(config, own)
        assert_same(folder, own)
    assert len({summary(folder)["ticks"] for _, folder in side_by_side}) > 1


def test_each_run_goes_on_by_itself_to_the_bits_of_a_whole_one(runs: Any) -> None:
    keep = {"state.every": 3, "strategy.name": "fedavgm", "strategy.momentum": 0.5}
    short = runs("short", (0, 1), {**keep, "train.max_ticks": 60})
    whole = runs("whole", (0, 1), {**keep, "train.max_ticks": 120})
    together.train(short)
    together.train(whole)
    for (_, folder), (_, expected) in zip(short, whole, strict=True):
        assert main(["train", f"resume={folder}", "train.max_ticks=120"]) == 0
        assert summary(folder)["digest"] == summary(expected)["digest"]
        assert rows(folder / "metrics.csv") == rows(expected / "metrics.csv")


def test_a_run_that_fails_leaves_the_others_to_their_bits(
    runs: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    save = session.save_server

    def full(writer: Any, state: Path, *rest: Any) -> None:
        if state.parent.name == "1":
            raise OSError(28, "No space left on device")
        save(writer, state, *rest)

    expected = [ending["digest"] for ending in together.train(runs("whole", (0, 1, 2)))]
    monkeypatch.setattr(session, "save_server", full)
    broken = runs("broken", (0, 1, 2), {"state.every": 4})
    first, second, third = together.train(broken)
    assert [first["digest"], third["digest"]] == [expected[0], expected[2]]
    assert isinstance(second, OSError)
    told = json.loads((broken[1][1] / "progress.json").read_text())
    assert (told["state"], told["message"]) == (
        "failed",
        "OSError: [Errno 28] No space left on device",
    )


def test_agents_that_differ_are_refused_by_the_stack(runs: Any) -> None:
    (first,), (second,) = runs("a", (0,)), runs("b", (1,), {"agent.hidden": [9]})
    ending, refused = together.train([first, second])
    assert isinstance(ending, dict)
    assert "agents that differ cannot share a stack" in str(refused)


# --- The command ----------------------------------------------------------------------------------


@pytest.fixture
def command(
    tiny_overrides: tuple[str, ...], tmp_path: Path, monkeypatch: Any
) -> Callable[..., int]:
    """Calls ``risfleet train`` with the tiny task, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *given: main(["train", *tiny_overrides, *given])


def test_the_command_leaves_the_folders_of_a_plain_sweep(
    command: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sweep = ("-m", "seed=3,4", "strategy=none,fedavg", "env.robots=2")
    assert command(*sweep, "--together", "run.dir=together") == 0
    said = capsys.readouterr().out
    assert command(*sweep, "run.dir=plain") == 0
    names = {path.name for path in (tmp_path / "plain").iterdir()}
    assert names == {path.name for path in (tmp_path / "together").iterdir()}
    for job in ("0", "1", "2", "3"):
        assert_same(tmp_path / "together" / job, tmp_path / "plain" / job)
        assert f"run folder: {tmp_path / 'together' / job}" in said
        assert str(tmp_path / "together" / job / "summary.json") in said
    found = [summary(tmp_path / "together" / job) for job in ("0", "1", "2", "3")]
    assert [(run["seed"], run["strategy"]) for run in found] == [
        (3, "none"), (3, "fedavg"), (4, "none"), (4, "fedavg"),
    ]  # fmt: skip
    assert [run["runs_together"] for run in found] == [2, 2, 2, 2]


@pytest.mark.parametrize(
    ("given", "part"),
    [
        (["--together"], "--together trains the seeds of a sweep: allowed with -m"),
        (["-m", "--together", "runtime=simulation", "seed=0,1"], "runtime=simulation: allowed is"),
        (["-m", "--together", "resume=runs/x"], "allowed without -m"),
        (["--together", "--cfg"], "--cfg prints one configuration"),
    ],
)
def test_together_is_for_sweeps_in_one_process(
    command: Callable[..., int], capsys: pytest.CaptureFixture[str], given: list[str], part: str
) -> None:
    assert command(*given) == 2
    said = capsys.readouterr().err
    assert part in said
    assert said.count("\n") == 1


def test_ctrl_c_stops_all_of_them_at_their_next_aggregation(
    command: Callable[..., int],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    begin = coordinator.Coordinator.turns

    def interrupted(self: Any, *given: Any) -> Any:
        turns = begin(self, *given)
        for _ in range(13):
            yield next(turns)
        if self._config.seed == 1:
            signal.raise_signal(signal.SIGINT)
        return (yield from turns)

    monkeypatch.setattr(coordinator.Coordinator, "turns", interrupted)
    assert command("-m", "--together", "seed=0,1,2", "strategy=fedavg,none", "run.dir=sweep") == 130
    assert "Stopped early by Ctrl-C" in capsys.readouterr().out
    for job in ("0", "2", "4"):
        found = summary(tmp_path / "sweep" / job)
        assert (found["stopped_early"], found["ticks"]) == (True, 20)
        assert not (tmp_path / "sweep" / job / "stop").exists()
    assert not (tmp_path / "sweep" / "1").exists()


def test_a_second_ctrl_c_ends_all_of_them_at_once(
    runs: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(self: Any, *given: Any) -> Any:
        yield
        if self._config.seed == 1:
            raise KeyboardInterrupt
        yield

    monkeypatch.setattr(coordinator.Coordinator, "turns", interrupted)
    going = runs("going", (0, 1, 2))
    with pytest.raises(KeyboardInterrupt):
        together.train(going)
    for _, folder in going:
        assert json.loads((folder / "progress.json").read_text())["state"] == "failed"
        assert not (folder / "summary.json").exists()


def test_a_robot_that_breaks_ends_its_own_run_alone(
    runs: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from client_app.robots import RobotGroup

    step = RobotGroup.step

    def failing(self: RobotGroup, told: Any) -> Any:
        if told.tick == 13 and self.seed == 1:
            raise MemoryError("out of memory")
        return step(self, told)

    made = RobotGroup.__init__

    def marked(self: RobotGroup, config: Config, *rest: Any) -> None:
        made(self, config, *rest)
        self.seed = config.seed

    monkeypatch.setattr(RobotGroup, "__init__", marked)
    monkeypatch.setattr(RobotGroup, "step", failing)
    endings = together.train(runs("going", (0, 1)))
    assert isinstance(endings[0], dict)
    assert isinstance(endings[1], RobotFailed)


# --- Processor time -------------------------------------------------------------------------------


def test_a_meter_counts_its_own_turns_and_what_is_added(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 10.0
    monkeypatch.setattr(time, "process_time", lambda: now)
    meter = Meter()
    assert meter() == 0.0
    with meter.running():
        now = 12.0
        assert meter() == 2.0
    now = 20.0
    meter.add(0.5)
    assert meter() == 2.5
