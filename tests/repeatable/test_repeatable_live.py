"""The command that kills, and real runs of the example under it."""

from __future__ import annotations

import random
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable
from functools import partial
from itertools import chain
from pathlib import Path

import pytest
from repeatable_helpers import CLIENTS, EXAMPLE, digest_of, play, wrapped

from repeatable import kills
from repeatable.__main__ import main
from repeatable.checkpoints import newest_round
from repeatable.live import LiveError, LiveRun
from repeatable.process_tracker import MARK, Deck, ProcessTracker
from repeatable.processes import Process, table

ROUNDS = 6


def test_a_schedule_is_the_seeds_and_within_the_run() -> None:
    drawn = [kills.schedule(random.Random(seed), 20, 7, 0.5) for seed in (0, 0, 1)]
    assert drawn[0] == drawn[1] != drawn[2]
    rounds = [kill.round for kill in drawn[0]]
    assert rounds == sorted(rounds)
    assert {*rounds} <= {*range(7)}
    assert all(0 <= kill.delay_s <= 0.5 for kill in drawn[0])


class FakeRun:
    """Two rounds in this process, and the rest when it may; its ServerApp is one that sleeps."""

    def __init__(self, folder: Path, may_end: Callable[[], bool] = lambda: True) -> None:
        self.folder, self.may_end = folder, may_end

    def __enter__(self) -> FakeRun:
        self.process = subprocess.Popen(["sleep", "1000"])
        self.tracker = ProcessTracker(self.process.pid, "none")
        self._play(min(max(newest_round(self.folder), 0) + 2, ROUNDS))
        return self

    def __exit__(self, *error: object) -> None:
        self.process.kill()
        self.process.wait()

    def roles(self) -> dict[str, list[Process]]:
        return {"ServerApp": [*self.tracker.alive()]}

    def state(self) -> str:
        if self.process.poll() is not None:
            return "finished:failed"
        if not self.may_end():
            return "running"
        self._play(ROUNDS)
        return "finished:completed"

    def said(self) -> str:
        return ""

    def _play(self, rounds: int) -> None:
        play(wrapped(state=self.folder), rounds, state=self.folder)


def test_kills_are_struck_in_order_until_the_run_has_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    live = partial(FakeRun, may_end=lambda: len(said) == 2)
    monkeypatch.setattr(kills.Task, "live", lambda task, folder: live(folder))
    monkeypatch.setattr(kills, "_ASK_S", 0.05)
    due = [kills.Kill(1, 0.0), kills.Kill(2, 0.01)]
    deck = Deck(["ServerApp"], random.Random(0))
    ending = kills.play(kills.Task(EXAMPLE, CLIENTS), tmp_path, due, deck, said.append)
    assert said == [f"ServerApp killed after round {number}" for number in (2, 4)]
    assert (ending.rounds, ending.killed) == (ROUNDS, 2)
    assert ending.digest == digest_of(wrapped(), ROUNDS)


def test_the_command_compares_runs_with_and_without_kills(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runs: list[FakeRun] = []

    def live(task: kills.Task, folder: Path) -> FakeRun:
        runs.append(FakeRun(folder, lambda: len(runs) != 2))  # the second one is to be killed
        return runs[-1]

    monkeypatch.setattr(kills.Task, "live", live)
    monkeypatch.setattr(kills, "_ASK_S", 0.05)
    arguments = [str(EXAMPLE), "--clients", "5", "--kills", "3", "--seed", "4"]
    assert main(["kill", *arguments, "--roles", "ServerApp"]) == 0
    lines = capsys.readouterr().out.splitlines()
    due = digest_of(wrapped(), ROUNDS)
    assert lines[0].startswith(f"undisturbed: {ROUNDS} rounds of ")
    assert (lines[0].split()[-1], lines[-1]) == (due, "the same bits")
    assert any(line.startswith("ServerApp killed after round") for line in lines)


def test_the_command_says_where_runs_differ(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    endings = iter(kills.Ending(3, name, 0.1, 0) for name in ("one", "other"))
    monkeypatch.setattr(kills, "play", lambda *arguments: next(endings))
    assert main(["kill", str(EXAMPLE), "--clients", "5"]) == 1
    assert capsys.readouterr().out.splitlines()[-1] == "NOT the same bits"


FLOWER = {
    "flower-superlink": """
import socket, time
server = socket.create_server(("127.0.0.1", int(arguments[arguments.index("--port") + 1])))
time.sleep(1000)
""",
    "flower-supernode": "import time; time.sleep(1000)",
    "flwr": """
import json
said = {"run": {"run-id": "7"}, "list": {"runs": [{"status": "running"}]}}
if arguments[0] == "log":
    print("first\\nlast")
elif "bad=1" in arguments:
    print(json.dumps({"success": False, "error-message": "bad is no key"}))
else:
    print(json.dumps({"success": True} | said[arguments[0]]))
""",
}


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Flower's commands, which note in a file how they were called."""
    log = tmp_path / "calls"
    for name, program in FLOWER.items():
        note = f"open({str(log)!r}, 'a').write(repr([{name!r}, *arguments]) + chr(10))"
        script = tmp_path / name
        script.write_text(
            f"#!{sys.executable}\nimport sys; arguments = sys.argv[1:]\n{note}\n{program}"
        )
        script.chmod(0o755)
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(tmp_path))
    return log


@pytest.mark.parametrize("deployment", [True, False])
def test_a_run_of_flowers_starts_what_it_takes_and_leaves_nothing(
    deployment: bool, calls: Path
) -> None:
    with kills.Task(EXAMPLE, 3, "a=1", deployment).live(Path("/state")) as run:
        assert (run.state(), run.said(1)) == ("running", "last")
        deadline = time.monotonic() + 60.0
        while calls.read_text().count("supernode") < 3 * deployment and time.monotonic() < deadline:
            time.sleep(0.05)
        home, there = run._home, {*chain(*run.roles().values())}
    assert len(there) >= 1 + 3 * deployment
    assert not home.exists()
    assert not there & {*table().values()}
    said = calls.read_text()
    assert [f"partition-id={k} num-partitions=3" in said for k in range(3)] == [deployment] * 3
    assert ("num-supernodes=3 " in said, "--simulation" in said) == (not deployment,) * 2
    assert """'--run-config', 'a=1 state-dir="/state"'""" in said


def test_what_flower_refuses_is_said_in_its_words(calls: Path) -> None:
    with pytest.raises(LiveError, match="`flwr run` failed: bad is no key"):  # noqa: SIM117
        with LiveRun(EXAMPLE, 2, "bad=1", deployment=False):
            pass


def test_a_run_that_stands_still_undisturbed_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kills.Task, "live", lambda task, folder: FakeRun(folder))
    monkeypatch.setattr(kills, "_STEADY_S", 0.0)
    monkeypatch.setattr(kills, "_ASK_S", 0.05)
    with pytest.raises(LiveError, match="undisturbed, the run ended as standing still after"):
        kills.play(kills.Task(EXAMPLE, CLIENTS), tmp_path)


def test_the_command_shows_what_a_folder_has_come_to(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    play(wrapped(state=tmp_path), 3, state=tmp_path)
    assert main(["digest", str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"round 3: {digest_of(wrapped(), 3)}\n"


def status(arguments: list[str]) -> object:
    try:
        return main(arguments)
    except SystemExit as end:
        return end.code


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["digest", "/nowhere"], "/nowhere holds no run: allowed is the state-dir of one"),
        (["kill", "/", "--clients", "2"], "holds no pyproject.toml: allowed is the folder of an"),
        (["kill", str(EXAMPLE), "--clients", "2", "--roles", "me"], "--roles=me: allowed are Cli"),
        (["kill", str(EXAMPLE), "--clients", "0"], "0: allowed is a whole number of at least 1"),
        (["kill", str(EXAMPLE), "--clients", "2", "--kills", "-1"], "at least 0"),
    ],
)
def test_mistakes_at_the_command_cost_a_sentence(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(arguments) == 2
    assert said in capsys.readouterr().err


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc")
def test_the_package_needs_no_flower_until_a_name_is_used() -> None:
    program = (
        "import sys, repeatable; assert 'flwr' not in sys.modules; repeatable.digest;"
        f" assert 'flwr' in sys.modules and {MARK!r}; assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True, cwd=EXAMPLE.parents[2])


# --- Flower and Ray -------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.flower
def test_a_simulation_that_is_killed_ends_in_the_bits_of_this_process(
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = ["--clients", "5", "--kills", "1", "--run-config", "rounds=40"]
    assert main(["kill", str(EXAMPLE), *arguments, "--roles", "ServerApp (engine)"]) == 0
    lines = capsys.readouterr().out.splitlines()
    due = digest_of(wrapped(), 40)
    assert lines[0].split()[-1] == due
    assert lines[-2:] == [f"1 of 1 kills: 40 rounds, {due}", "the same bits"]


@pytest.mark.slow
@pytest.mark.flower
def test_a_deployment_whose_server_is_killed_ends_in_the_bits_of_this_process(
    tmp_path: Path,
) -> None:
    task = kills.Task(EXAMPLE, CLIENTS, "rounds=2", deployment=True)
    deck = Deck(["ServerApp"], random.Random(0))
    ending = kills.play(task, tmp_path, [kills.Kill(1, 0.5)], deck)
    assert (ending.rounds, ending.killed) == (2, 1)
    assert ending.digest == digest_of(wrapped(), 2)
