"""Buildings on Flower's runtimes: the bits of one process, and rooms that come and go."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from flower_helpers import (
    PATIENCE_S,
    OwnFederation,
    commands,
    digests_in_one_process,
    own_federation,
    summary,
    wait_until,
    with_changes,
)

from experiments.cli import main
from experiments.flower.environment import CONNECTION
from repeatable.processes import command, members
from storage.checkpoint_layout import node_folder, room_folder
from training.run_folder import RunFolder

pytestmark = [
    pytest.mark.slow,
    pytest.mark.flower,
    pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc"),
]

ROOMS = (
    "rooms.count=4",
    "rooms.plans=[default,corridor]",
    "rooms.every=2",
    "rooms.held_out=1",
    "env.robots=2",
    "env.motion.max_slots=40",
    "agent.hidden=[13,11]",
    "agent.batch_size=8",
    "agent.learn_from=8",
    "agent.replay_size=64",
    "agent.epsilon.ticks=150",
    "federation.every=10",
    "train.max_ticks=200",
    "train.episodes=100000000",
    "evaluation.every=1000000",
    "evaluation.episodes=2",
    "run.figures=false",
)


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The digests of the building in one process, to which nothing happens."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    return digests_in_one_process(ROOMS, folder, "runtime=local")


@pytest.mark.parametrize(
    ("runtime", "clients"), [("simulation", 2), ("simulation", 3), ("deployment", 2)]
)
def test_every_runtime_and_dealing_of_rooms_ends_in_the_bits_of_one_process(
    tmp_path: Path,
    expected: dict[str, str],
    runtime: str,
    clients: int,
) -> None:
    folder = tmp_path / "run"
    where = (f"runtime={runtime}", f"federation.clients={clients}", f"run.dir={folder}")
    assert main(["train", *with_changes(ROOMS, *where)]) == 0
    assert summary(folder)["digest"] == expected


@pytest.fixture
def federation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[OwnFederation]:
    """A SuperLink that no SuperNode has joined yet."""
    with own_federation(tmp_path) as federation:
        monkeypatch.setenv("FLWR_HOME", str(federation.session.folder))
        yield federation


@pytest.fixture
def begin(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts a building on the federation, as a process."""
    where = ("runtime=deployment", f"runtime.connection={CONNECTION}", "federation.clients=2")
    with commands(tmp_path) as run:
        yield lambda folder, *changes: run(
            with_changes(ROOMS, *where, *changes, f"run.dir={folder}")
        )


def test_a_site_that_is_killed_is_waited_for_and_the_bits_stay(
    tmp_path: Path,
    federation: OwnFederation,
    begin: Callable[..., subprocess.Popen[str]],
    expected: dict[str, str],
) -> None:
    folder = tmp_path / "run"
    federation.join(0)
    second = federation.join(1)
    process = begin(folder)
    wait_until(lambda: rounds(folder) > 2, process)
    for row in members(federation.session.marker):
        if "flwr-clientapp" in command(row):
            os.kill(row.pid, signal.SIGKILL)
    second.kill()
    second.wait()
    federation.join(1)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors
    assert summary(folder)["digest"] == expected


def test_with_miss_a_site_joins_late_leaves_and_comes_back(
    tmp_path: Path, federation: OwnFederation, begin: Callable[..., subprocess.Popen[str]]
) -> None:
    folder = tmp_path / "run"
    federation.join(0)
    long = ("train.max_ticks=100000", "federation.on_loss=miss", "runtime.start_timeout_s=5")
    process = begin(folder, *long)
    wait_until(lambda: rounds(folder) > 1, process)
    assert missing(folder) == [2, 3]
    second = federation.join(1)
    wait_until(lambda: missing(folder) == [], process)
    own = room_folder(node_folder(federation.state_dir(1), run_id(folder)), "0003")
    assert any(own.iterdir())
    second.kill()
    second.wait()
    wait_until(lambda: missing(folder) == [2, 3], process)
    federation.join(1)
    wait_until(lambda: missing(folder) == [], process)
    RunFolder(folder).stop_file.touch()
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors
    ticks = summary(folder)["rooms"]["ticks"]
    assert ticks[0] == ticks[1] > ticks[2] == ticks[3] > 0


def rounds(folder: Path) -> int:
    """The round that a building plays."""
    return (RunFolder(folder).read_progress() or {}).get("round") or 0


def missing(folder: Path) -> list[int]:
    """The rooms that were asked and did not come in the last round that is told of."""
    found: list[int] = (RunFolder(folder).read_progress() or {})["rooms"]["missing"]
    return found


def run_id(folder: Path) -> str:
    """The name that a run's checkpoints carry."""
    return str(RunFolder(folder).read_config().run.id)
