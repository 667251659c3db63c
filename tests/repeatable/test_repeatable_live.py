"""The command that kills, and real runs of the example under it."""

from __future__ import annotations

import random
import subprocess
import sys
from pathlib import Path

import pytest
from repeatable_helpers import CLIENTS, EXAMPLE, digest_of, play, wrapped

from repeatable import kills
from repeatable.__main__ import main
from repeatable.checkpoints import newest_round
from repeatable.live import LiveError
from repeatable.process_tracker import MARK, Deck, ProcessTracker
from repeatable.processes import Process


def test_a_schedule_is_the_seeds_and_within_the_run() -> None:
    drawn = [kills.schedule(random.Random(seed), 20, 7, 0.5) for seed in (0, 0, 1)]
    assert drawn[0] == drawn[1] != drawn[2]
    rounds = [kill.round for kill in drawn[0]]
    assert rounds == sorted(rounds)
    assert {*rounds} <= {*range(7)}
    assert all(0 <= kill.delay_s <= 0.5 for kill in drawn[0])


class FakeRun:
    """A run in this process, whose ServerApp is a process that sleeps."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __enter__(self) -> FakeRun:
        self.process = subprocess.Popen(["sleep", "1000"])
        self.tracker = ProcessTracker(self.process.pid, "none")
        self.rounds = max(newest_round(self.folder), 0) + 2
        play(wrapped(state=self.folder), min(self.rounds, 6), state=self.folder)
        return self

    def __exit__(self, *error: object) -> None:
        self.process.kill()
        self.process.wait()

    def roles(self) -> dict[str, list[Process]]:
        return {"ServerApp": [*self.tracker.alive()]}

    def state(self) -> str:
        return "finished:completed" if self.rounds >= 6 else "running"

    def said(self) -> str:
        return ""


def test_kills_are_struck_in_order_until_the_run_has_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kills.Task, "live", lambda task, folder: FakeRun(folder))
    monkeypatch.setattr(kills, "_ASK_S", 0.1)
    said: list[str] = []
    due = [kills.Kill(1, 0.0), kills.Kill(2, 0.01)]
    deck = Deck(["ServerApp"], random.Random(0))
    ending = kills.play(kills.Task(EXAMPLE, CLIENTS), tmp_path, due, deck, said.append)
    assert said == [f"ServerApp killed after round {number}" for number in (2, 4)]
    assert (ending.rounds, ending.killed) == (6, 2)
    assert ending.digest == digest_of(wrapped(), 6)


def test_a_run_that_stands_still_undisturbed_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kills.Task, "live", lambda task, folder: FakeRun(folder))
    monkeypatch.setattr(kills, "_STEADY_S", 0.0)
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
    assert lines[0] == f"undisturbed: 40 rounds, {due}"
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
