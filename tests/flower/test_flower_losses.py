"""Runs that lose a process or a disk and do not wait: their last words, and how they go on."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import disks
import pytest
from flower_helpers import (
    PATIENCE_S,
    commands,
    digests_in_one_process,
    own_federation,
    state_of,
    summary,
    wait_until,
    watched,
    with_changes,
)

from experiments.cli import main
from experiments.flower.environment import CONNECTION
from repeatable.processes import command, members
from storage.checkpoint_files import checkpoints
from storage.checkpoint_layout import server_folder

pytestmark = [
    pytest.mark.slow,
    pytest.mark.flower,
    pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc"),
]

TASK = (
    "env.robots=2",
    "env.tasks.destinations_m=[[7.5,2.5],[1.5,1.5]]",
    "train.max_ticks=5000",
    "train.episodes=100000000",
    "evaluation.every=1000000",
    "state.every=10",
    "federation.clients=2",
)


@pytest.fixture(scope="module")
def expected(
    tiny_overrides: Sequence[str], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, str]:
    """The digests of the run in one process, to which nothing happens."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    return digests_in_one_process(tiny_overrides, folder, *TASK)


@pytest.fixture
def begun(
    tmp_path: Path, tiny_overrides: Sequence[str]
) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts a run as a process and waits for its second checkpoint."""
    with commands(tmp_path) as run:

        def make(folder: Path, *changes: str) -> subprocess.Popen[str]:
            process = run(with_changes(tiny_overrides, *TASK, *changes, f"run.dir={folder}"))
            wait_until(lambda: len(checkpoints(server_folder(folder / "state"))) > 1, process)
            return process

        yield make


# --- A process ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("runtime", "role"),
    [
        ("deployment", "flwr-clientapp"),
        ("deployment", "flower-supernode"),
        ("simulation", "ray::ClientAppActor"),
    ],
)
def test_with_abort_a_killed_process_ends_the_run_by_the_robots_name_and_a_resume_goes_on(
    tmp_path: Path,
    begun: Callable[..., subprocess.Popen[str]],
    expected: dict[str, str],
    runtime: str,
    role: str,
) -> None:
    folder = tmp_path / "run"
    process = begun(folder, f"runtime={runtime}", "federation.on_loss=abort")
    with watched(process) as marker_of:
        marker = marker_of()
        victim = next(row for row in members(marker) if role in command(row))
        os.kill(victim.pid, signal.SIGKILL)
        _, errors = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 1, errors
        first, *_, last = errors.strip().splitlines()
        where = r"(at tick \d+, window \d+|in round \d+, which began after window \d+)"
        say = rf"risfleet: The run failed: RobotLost: robot [01] lost {where}: "
        assert re.match(say, first), errors
        assert last == f"To go on: risfleet train resume={folder}"
        assert state_of(folder) == "failed"
        assert members(marker) == set()
    assert not (folder / "summary.json").exists()
    assert main(["train", f"resume={folder}"]) == 0
    assert summary(folder)["digest"] == expected


# --- A disk ---------------------------------------------------------------------------------------


@pytest.fixture
def nodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int], Path]]:
    """A federation of two SuperNodes, each with a ``state-dir``; tells that of each node."""
    with own_federation(tmp_path) as federation:
        federation.join(0)
        federation.join(1)
        monkeypatch.setenv("FLWR_HOME", str(federation.session.folder))
        yield federation.state_dir


@pytest.mark.skipif(bool(disks.obstacle()), reason=disks.obstacle() or "none")
@pytest.mark.parametrize(
    ("whose", "kind", "says"),
    [
        ("node", "full", r"RobotFailed: robot [01] failed at tick \d+.*No space left on device"),
        ("node", "read_only", r"RobotFailed: robot [01] failed at tick \d+.*Read-only file system"),
        ("server", "full", r"No space left on device"),
    ],
)
def test_a_disk_that_takes_nothing_ends_a_deployment_by_name_and_a_resume_goes_on(
    tmp_path: Path,
    nodes: Callable[[int], Path],
    begun: Callable[..., subprocess.Popen[str]],
    expected: dict[str, str],
    whose: str,
    kind: str,
    says: str,
) -> None:
    disk = nodes(1) if whose == "node" else tmp_path / "disk"
    folder = tmp_path / "run" if whose == "node" else disk / "run"
    with disks.small_disk(disk, "16m"), ExitStack() as trouble:
        process = begun(folder, "runtime=deployment", f"runtime.connection={CONNECTION}")
        if kind == "full":
            disks.fill(disk)
            trouble.callback(disks.free, disk)
        else:
            trouble.enter_context(disks.read_only(disk))
        _, errors = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 1, errors
        assert errors.startswith("risfleet: "), errors
        assert re.search(f"{says}.*{re.escape(str(disk))}", errors), errors
        assert errors.strip().endswith(f"To go on: risfleet train resume={folder}")
        trouble.close()
        assert main(["train", f"resume={folder}"]) == 0
        assert summary(folder)["digest"] == expected
