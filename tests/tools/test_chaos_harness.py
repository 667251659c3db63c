"""The harness sees what it should: processes, moments, and damage of every kind."""

from __future__ import annotations

import json
import os
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from experiments.cli import main
from repeatable.process_tracker import MARK, Deck, ProcessTracker, aim, role_of
from repeatable.processes import Process
from storage.checkpoint_files import save_checkpoint
from storage.checkpoint_layout import round_folder, server_folder
from tools.chaos.kill_points import (
    FINISHING,
    JOINING,
    MIDDLE,
    ROUND,
    WRITING,
    KillPoint,
    Watched,
    draw,
    newest,
)
from tools.chaos.tasks import LOCAL, ROLES, SIMULATION
from tools.chaos.verdict import (
    damaged,
    differences,
    has_ended,
    is_clear,
    resumed_window,
    unfinished,
)

PATIENCE_S = 120.0

# --- Processes ------------------------------------------------------------------------------------

COMMANDS = {
    "ClientApp": ["ray::ClientAppActor.run", "python /bin/flwr-clientapp --token x"],
    "ServerApp": ["python /bin/flwr-serverapp --token x"],
    "ServerApp (engine)": ["python /bin/flwr-simulation --token x"],
    "SuperNode": ["python /bin/flower-supernode --insecure"],
    "SuperExec": ["python /bin/flower-superexec --insecure"],
    "SuperLink": ["python /bin/flower-superlink --insecure"],
    "flwr command": ["python /bin/flwr run ."],
    "watchdog": ["python -P -m experiments.flower.watchdog 0a /tmp/rf"],
    "raylet": ["/lib/site-packages/ray/core/src/ray/raylet/raylet --x"],
    "Ray GCS": ["/lib/site-packages/ray/core/src/ray/gcs/gcs_server --x"],
    "Ray agent": ["ray::DashboardAgent", "python /lib/site-packages/ray/dashboard/agent.py --x"],
    "Ray service": ["python /lib/site-packages/ray/dashboard/dashboard.py --x"],
    "other": ["sleep 1000"],
}


@pytest.mark.parametrize(("role", "lines"), COMMANDS.items())
def test_a_process_is_known_by_its_command(role: str, lines: list[str]) -> None:
    assert {role_of(line, ROLES) for line in lines} == {role}


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc")
def test_a_crowd_holds_orphans_in_sessions_of_their_own_and_ends_them() -> None:
    program = (
        "import subprocess, sys\n"
        "subprocess.Popen(['sleep', '1000'], start_new_session=True)\n"
        "sys.stdin.read()\n"
    )
    launcher = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, env=os.environ | {MARK: "here"}
    )
    crowd = ProcessTracker(launcher.pid, "here")
    try:
        deadline = time.monotonic() + PATIENCE_S
        while len(crowd.roles()) < 2 and time.monotonic() < deadline:
            time.sleep(0.01)
        roles = crowd.roles()
        assert [row.pid for row in roles["launcher"]] == [launcher.pid]
        target = aim(roles["launcher"][0])
        assert target is not None
        assert target.kill()
        launcher.wait()
        assert crowd.wait_gone(0.0)[0] == set(roles["other"])
        assert set(roles["other"]) <= ProcessTracker(launcher.pid, "here").alive()
    finally:
        crowd.end()
        launcher.kill()
        launcher.communicate()
    assert crowd.alive() == set()


def test_every_role_has_its_turn_as_soon_as_it_is_there() -> None:
    deck = Deck(["a", "b", "c"], random.Random(0))
    early, late = Process(1, "1"), Process(2, "2")
    assert deck.pick({"other": [late]}) is None
    assert deck.pick({"a": [early]}) == ("a", early)
    everyone = {"a": [early], "b": [late], "c": [early, late], "other": [late]}
    picked = [deck.pick(everyone) for _ in range(6)]
    assert sorted(role for role, _ in filter(None, picked[:3])) == ["a", "b", "c"]
    assert sorted(role for role, _ in filter(None, picked[3:])) == ["a", "b", "c"]


# --- Moments --------------------------------------------------------------------------------------


def says(folder: Path, state: str, at: float) -> None:
    folder.mkdir(exist_ok=True)
    (folder / "progress.json").write_text(json.dumps({"state": state, "written_at": at}))


def test_moments_are_told_by_what_this_process_has_written(tmp_path: Path) -> None:
    watched = Watched(tmp_path, 3, since=100.0)
    says(tmp_path, "finishing", 99.0)
    assert not watched.reached(KillPoint(JOINING))
    assert not watched.reached(KillPoint(FINISHING))
    says(tmp_path, "starting", 101.0)
    assert watched.reached(KillPoint(JOINING))
    says(tmp_path, "finishing", 102.0)
    assert watched.reached(KillPoint(FINISHING))


def test_a_window_is_reached_with_its_checkpoint_and_a_round_with_any_robots(
    tmp_path: Path,
) -> None:
    watched = Watched(tmp_path, 3, since=time.time() - 10)
    save_checkpoint(server_folder(tmp_path / "state"), 4, {}, {})
    assert [watched.reached(KillPoint(MIDDLE, window)) for window in (4, 6)] == [True, False]
    assert not watched.reached(KillPoint(ROUND, 20))
    save_checkpoint(round_folder(tmp_path / "state", 2), 20, {}, {})
    assert watched.reached(KillPoint(ROUND, 20))
    assert newest(tmp_path / "state", 3) == 20


def test_a_half_written_checkpoint_of_an_earlier_process_is_no_moment(tmp_path: Path) -> None:
    server = server_folder(tmp_path / "state")
    save_checkpoint(server, 4, {}, {})
    torn = server / "checkpoint-000000000006.writing"
    torn.write_bytes(b"half")
    os.utime(torn, (90.0, 90.0))
    assert not Watched(tmp_path, 3, since=100.0).is_writing()
    assert Watched(tmp_path, 3, since=80.0).is_writing()


@pytest.mark.parametrize("first", [0, 41, 78, 80])
def test_moments_lie_behind_what_was_played_before(first: int) -> None:
    rng = random.Random(1)
    moments = [draw(rng, SIMULATION, first) for _ in range(300)]
    told = [m.window for m in moments if m.kind in (MIDDLE, WRITING, ROUND)]
    assert all(first < window < SIMULATION.windows for window in told)
    assert bool(told) == (first < 76)
    assert ROUND not in {draw(rng, LOCAL, first).kind for _ in range(100)}


# --- Verdicts -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, tiny_overrides: tuple[str, ...]) -> Path:
    """A run's folder, not to be changed."""
    folder: Path = tmp_path_factory.mktemp("harness") / "whole"
    assert main(["train", *tiny_overrides, "state.every=3", f"run.dir={folder}"]) == 0
    return folder


def rewrite(path: Path, change: Callable[[str], str]) -> None:
    path.write_text(change(path.read_text()))


def test_every_kind_of_damage_is_seen(whole: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(whole, copy)
    assert has_ended(copy)
    assert differences(copy, whole) == []
    doubled = [(copy / "metrics.csv").read_text().splitlines(keepends=True)[-1]]
    rewrite(copy / "metrics.csv", lambda text: text + doubled[0])
    rewrite(copy / "evaluations.csv", lambda text: "".join(text.splitlines(keepends=True)[:-1]))
    rewrite(copy / "summary.json", lambda text: text.replace('"robots": "', '"robots": "0'))
    shutil.copy(copy / "state/server/checkpoint-000000000009.safetensors", copy / "kept")
    path = copy / "state/server/checkpoint-000000000009.safetensors"
    path.write_bytes(path.read_bytes()[:-7])
    found = differences(copy, whole)
    assert [text.split(":")[0] for text in found[:3]] == [
        "summary.json",
        "metrics.csv",
        "evaluations.csv",
    ]
    assert len(damaged(copy / "state")) == 1
    (copy / "weights.safetensors").unlink()
    assert not has_ended(copy)


def test_clocks_make_no_difference(whole: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(whole, copy)
    lines = (copy / "evaluations.csv").read_text().splitlines()
    place = lines[0].split(",").index("cpu_s")
    fields = lines[1].split(",")
    fields[place] = "123.4"
    (copy / "evaluations.csv").write_text("\n".join([lines[0], ",".join(fields), *lines[2:]]))
    assert differences(copy, whole) == []


def test_half_written_files_are_named_and_do_not_count(whole: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(whole, tmp_path / "copy")
    (copy / "state/server/checkpoint-000000000012.writing").write_bytes(b"half")
    (copy / ".summary.json.17").write_text("{")
    names = ["state/server/checkpoint-000000000012.writing", ".summary.json.17"]
    assert unfinished(copy) == sorted(names)
    assert differences(copy, whole) == []


def test_a_sentence_is_clear_where_nothing_stands_above_it() -> None:
    assert is_clear("risfleet: Flower's SuperLink ended with status -9.\nlog\n")
    assert not is_clear("Traceback (most recent call last):\nrisfleet: late\n")
    assert not is_clear("risfleet: \n")
    assert not is_clear("")
    assert resumed_window("run folder: x\ngoing on from window 46\n") == 46
    assert resumed_window("run folder: x\n") is None
