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
from experiments.folders import alone
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
    "server Adam": {
        "strategy.name": "fedadam",
        "strategy.server_rate": 0.003,
        "strategy.tau": 0.001,
    },
    "median": {"strategy.name": "fedmedian"},
    "Krum": {"strategy.name": "krum", "strategy.malicious": 0},
    "a random phase": {"scheme.phase": "random"},
    "the best phase": {"scheme.phase": "oracle"},
    "OMA": {"env.access": "oma"},
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


def train(runs: Sequence[tuple[Config, Path]], *, missing: bool = False) -> list[Any]:
    return together.train(*zip(*runs, strict=True), missing=missing)


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
    endings = train(side_by_side)
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
    train(side_by_side)
    for (config, own), (_, folder) in zip(alone, side_by_side, strict=True):
        local.train(config, own)
        assert_same(folder, own)
    assert len({summary(folder)["ticks"] for _, folder in side_by_side}) > 1


def test_each_run_goes_on_by_itself_to_the_bits_of_a_whole_one(runs: Any) -> None:
    keep = {"state.every": 3, "strategy.name": "fedavgm", "strategy.momentum": 0.5}
    short = runs("short", (0, 1), {**keep, "train.max_ticks": 60})
    whole = runs("whole", (0, 1), {**keep, "train.max_ticks": 120})
    train(short)
    train(whole)
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

    expected = [ending["digest"] for ending in train(runs("whole", (0, 1, 2)))]
    monkeypatch.setattr(session, "save_server", full)
    broken = runs("broken", (0, 1, 2), {"state.every": 4})
    first, second, third = train(broken)
    assert [first["digest"], third["digest"]] == [expected[0], expected[2]]
    assert isinstance(second, OSError)
    told = json.loads((broken[1][1] / "progress.json").read_text())
    assert (told["state"], told["message"]) == (
        "failed",
        "OSError: [Errno 28] No space left on device",
    )


CENTRAL = {"strategy.name": "none", "env.robots": 2}


@pytest.mark.parametrize(
    "changes",
    [
        {"scheme.agents": "branching", **CENTRAL},
        {"scheme.agents": "centralized", **CENTRAL},
        {"agent.updates": 2},
        {"agent.priority.alpha": 0.6},
    ],
    ids=["branching", "centralized", "several updates", "priorities"],
)
def test_agents_that_have_no_stack_are_trained_one_by_one(
    runs: Any, changes: dict[str, Any]
) -> None:
    ours, alone = runs("together", (3, 4), changes), runs("alone", (3, 4), changes)
    for ending, (_, folder), (config, own) in zip(train(ours), ours, alone, strict=True):
        assert ending["digest"] == local.train(config, own)["digest"]
        assert_same(folder, own)
        assert summary(folder)["runs_together"] == 1


def test_other_values_may_share_a_stack_where_networks_are_alike(runs: Any) -> None:
    values = ({"env.power.max_dbm": 10.0}, {"env.access": "oma"}, {"strategy.name": "none"})
    ours = [runs(f"together {at}", (1,), change)[0] for at, change in enumerate(values)]
    alone = [runs(f"alone {at}", (1,), change)[0] for at, change in enumerate(values)]
    for ending, (config, own) in zip(train(ours), alone, strict=True):
        assert ending["digest"] == local.train(config, own)["digest"]
        assert ending["runs_together"] == 3


def test_agents_that_differ_are_refused_by_the_stack(runs: Any) -> None:
    (first,), (second,) = runs("a", (0,)), runs("b", (1,), {"agent.hidden": [9]})
    ending, refused = train([first, second])
    assert isinstance(ending, dict)
    assert "agents that differ cannot share a stack" in str(refused)


# --- What is missing ------------------------------------------------------------------------------


def test_only_what_is_missing_is_trained_and_to_the_same_bits(
    runs: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep, seeds = {"state.every": 3}, (0, 1, 2, 3)
    whole, parts = runs("whole", seeds, keep), runs("parts", seeds, keep)
    train(whole)
    train(parts[:1])
    ended = parts[0][1] / "summary.json"
    written = ended.stat().st_mtime_ns
    begin = coordinator.Coordinator.turns

    def dying(self: Any, *given: Any) -> Any:
        turns = begin(self, *given)
        for _ in range({1: 80, 2: 15}[self._config.seed]):  # after and before a first checkpoint
            yield next(turns)
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patched:
        patched.setattr(coordinator.Coordinator, "turns", dying)
        assert [type(ending) for ending in train(parts[1:3])] == [OSError, OSError]
    endings = train(parts, missing=True)
    assert ended.stat().st_mtime_ns == written
    for ending, (_, folder), (_, expected) in zip(endings, parts, whole, strict=True):
        assert ending == summary(folder)
        assert summary(folder)["digest"] == summary(expected)["digest"]
        assert rows(folder / "metrics.csv") == rows(expected / "metrics.csv")
        assert json.loads((folder / "progress.json").read_text())["state"] == "done"
    assert [ending["runs_together"] for ending in endings] == [1, 3, 3, 3]


def test_a_longer_run_is_missing_and_a_run_that_went_further_is_not_taken_for_it(
    runs: Any,
) -> None:
    keep = {"state.every": 3}
    short = runs("runs", (0,), {**keep, "train.max_ticks": 60})
    long = runs("runs", (0,), {**keep, "train.max_ticks": 120})
    (expected,) = train(runs("whole", (0,), {**keep, "train.max_ticks": 120}))
    train(short)
    (found,) = train(long, missing=True)
    assert found["digest"] == expected["digest"]
    (refused,) = train(short, missing=True)
    assert str(refused).endswith("allowed is a folder whose run has not gone beyond this.")


def test_without_checkpoints_an_ended_run_is_left_and_another_begins_again(runs: Any) -> None:
    keep = {"state.every": None}
    given = runs("runs", (0, 1), keep)
    expected = [ending["digest"] for ending in train(given)]
    (given[1][1] / "weights.safetensors").unlink()
    assert [ending["digest"] for ending in train(given, missing=True)] == expected
    assert [summary(folder)["runs_together"] for _, folder in given] == [2, 1]


def test_a_folder_of_another_run_or_of_a_running_one_is_left_as_it_is(runs: Any) -> None:
    given = [
        *runs("runs", (0, 1, 2, 3)),
        *runs("elsewhere", (4,), {"runtime.name": "simulation"}),
    ]
    train(runs("runs", (0,), {"agent.learning_rate": 0.02}))
    given[1][1].mkdir(parents=True)
    (given[1][1] / "notes.txt").write_text("mine")
    before = (given[0][1] / "summary.json").read_bytes()
    given[2][1].mkdir(parents=True)
    with alone(given[2][1]):
        *refused, done, elsewhere = train(given, missing=True)
    assert ["new, empty or of this run" in str(error) for error in refused] == [True, True, False]
    assert "runtime=simulation: allowed is local" in str(elsewhere)
    assert "a folder in which no run is going on" in str(refused[2])
    assert [path.name for path in given[1][1].iterdir()] == ["notes.txt"]
    assert (given[0][1] / "summary.json").read_bytes() == before
    assert done["seed"] == 3


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


@pytest.mark.slow
def test_a_sweep_of_one_agent_for_everything_is_run_one_by_one(
    command: Callable[..., int], tmp_path: Path
) -> None:
    sweep = ("-m", "seed=3,4", "baseline=branching,none", "env.robots=2")
    assert command(*sweep, "--together", "run.dir=together") == 0
    assert command(*sweep, "run.dir=plain") == 0
    for job in ("0", "1", "2", "3"):
        assert_same(tmp_path / "together" / job, tmp_path / "plain" / job)
    found = [summary(tmp_path / "together" / job) for job in ("0", "1", "2", "3")]
    assert [run["runs_together"] for run in found] == [1, 2, 1, 2]


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
        train(going)
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
    endings = train(runs("going", (0, 1)))
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
