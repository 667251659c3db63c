"""Whole runs on Flower's runtimes: the bits of one process, and nothing left behind."""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import socket
import subprocess
import sysconfig
import uuid
import zipfile
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path

import pytest
from flower_helpers import (
    PATIENCE_S,
    digests_in_one_process,
    start,
    state_of,
    summary,
    wait_until,
    watched,
    with_changes,
)
from safetensors.numpy import load_file

from experiments.cli import main
from experiments.flower import superlink
from experiments.flower.environment import child_environment, free_port
from experiments.flower.manifest import Components
from experiments.flower.session import Session
from repeatable.processes import command, members, terminate
from storage.checkpoint_files import checkpoints, digest
from storage.checkpoint_layout import server_folder

ROOT = Path(__file__).parents[2]
ELSEWHERE = {
    "all_proxy": "socks5://127.0.0.1:9",
    "HTTP_PROXY": "http://127.0.0.1:9",
    "SSL_CERT_FILE": "/nowhere",
    "FORCE_COLOR": "1",
    "RAY_ADDRESS": "127.0.0.1:9",
    "FLWR_OIDC_ENABLED": "1",
}
LENGTH = ("train.max_ticks=50", "federation.every=25")
MANY = (
    "train.worlds=4",
    "env.reward.credit=difference",
    "env.reward.weights=objective",
    "env.state.others=1",
    "env.state.way=on",
    "env.state.weights=true",
    "env.state.order=gain",
)
"""Worlds, credit and broadcasts: all that makes frames longer."""

Train = Callable[..., int]
Expected = Callable[..., dict[str, str]]


@pytest.fixture
def sessions(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Session]]:
    """The sessions that a test starts: at its end none of their processes and folders is left."""
    started: list[Session] = []
    begin = Session.__init__

    def remembered(self: Session) -> None:
        begin(self)
        started.append(self)

    monkeypatch.setattr(Session, "__init__", remembered)
    yield started
    for session in started:
        left = members(session.marker)
        terminate(session.marker)
        assert left == set()
        assert not session.folder.exists()


@pytest.fixture
def train(tmp_path: Path, tiny_overrides: Sequence[str], monkeypatch: pytest.MonkeyPatch) -> Train:
    """Trains the tiny task with the command, in the test's folder of the given name.

    Its user has an environment that leads Flower and Ray elsewhere.
    """
    monkeypatch.chdir(tmp_path)
    for name, value in ELSEWHERE.items():
        monkeypatch.setenv(name, value)

    def run(name: str, *changes: str) -> int:
        given = with_changes(tiny_overrides, *LENGTH, *changes, f"run.dir={tmp_path / name}")
        return main(["train", *given])

    return run


@pytest.fixture(scope="module")
def expected(tiny_overrides: Sequence[str], tmp_path_factory: pytest.TempPathFactory) -> Expected:
    """The digests of the tiny task in one process, with changes."""

    @cache
    def of(*changes: str) -> dict[str, str]:
        folder = tmp_path_factory.mktemp("local") / "run"
        return digests_in_one_process(tiny_overrides, folder, *LENGTH, *changes)

    return of


# --- The same bits --------------------------------------------------------------------------------


@pytest.mark.flower
@pytest.mark.parametrize(
    ("clients", "per_round", "task"),
    [(2, 1, MANY), pytest.param(2, "null", (), marks=pytest.mark.slow)],
    ids=["many_worlds", "two_clients"],
)
def test_the_simulation_ends_in_the_bits_of_one_process(
    tmp_path: Path,
    train: Train,
    expected: Expected,
    sessions: list[Session],
    capsys: pytest.CaptureFixture[str],
    clients: int,
    per_round: int | str,
    task: Sequence[str],
) -> None:
    changes = [f"federation.clients={clients}", f"federation.windows_per_round={per_round}"]
    status = train("run", "runtime=simulation", *changes, *task)
    said = capsys.readouterr()
    assert status == 0, said.err
    found = summary(tmp_path / "run")
    assert found["digest"] == expected(*task)
    assert (found["runtime"], found["ticks"], found["windows"]) == ("simulation", 50, 2)
    assert found["flower_share"] > 0
    assert found["costs"]["bytes_to_robots"] > 0
    arrays = load_file(tmp_path / "run" / "weights.safetensors")
    assert digest(arrays["robots"]) == expected(*task)["robots"]
    assert state_of(tmp_path / "run") == "done"
    assert "last 5 in training" in said.out
    assert (tmp_path / "run" / "flower.log").stat().st_size > 0
    assert len(sessions) == 1


@pytest.mark.flower
@pytest.mark.parametrize(
    "changes",
    [
        ["federation.clients=2", "runtime.secure=true"],
        pytest.param(["federation.clients=1"], marks=pytest.mark.slow),
        pytest.param(["federation.windows_per_round=1"], marks=pytest.mark.slow),
        pytest.param(["federation.clients=2", *MANY], marks=pytest.mark.slow),
    ],
    ids=["secure", "one_client", "two_rounds", "many_worlds"],
)
def test_a_deployment_ends_in_the_bits_of_one_process(
    tmp_path: Path,
    train: Train,
    expected: Expected,
    sessions: list[Session],
    capsys: pytest.CaptureFixture[str],
    changes: list[str],
) -> None:
    status = train("run", "runtime=deployment", *changes)
    assert status == 0, capsys.readouterr().err
    found = summary(tmp_path / "run")
    task = [change for change in changes if change in MANY]
    assert found["digest"] == expected(*task)
    assert (found["runtime"], found["windows"], found["losses"]) == ("deployment", 2, [])
    clients = {"federation.clients=1": 1, "federation.clients=2": 2}.get(changes[0], 3)
    assert len(found["clients"]) == clients
    assert all(client["cpu_s"] > 0 for client in found["clients"])
    log = (tmp_path / "run" / "flower.log").read_text(errors="replace")
    secure = "runtime.secure=true" in changes
    assert log.count(f"with{'' if secure else 'out'} TLS") >= clients
    assert ("https://127.0.0.1" in log) is secure
    assert len(sessions) == 1


@pytest.mark.flower
@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc")
@pytest.mark.parametrize("role", ["flwr-clientapp", "flower-supernode", "flwr-serverapp"])
def test_a_deployment_outlives_a_killed_process(
    tmp_path: Path, tiny_overrides: Sequence[str], role: str
) -> None:
    length = ["train.max_ticks=20000", "train.episodes=100000000", "state.every=10"]
    folder = tmp_path / "run"
    given = with_changes(tiny_overrides, *length, "runtime=deployment", f"run.dir={folder}")
    process = start(given, tmp_path)
    with watched(process) as marker_of:
        wait_until(lambda: len(checkpoints(server_folder(folder / "state"))) > 1, process)
        marker = marker_of()
        victim = next(row for row in members(marker) if role in command(row))
        os.kill(victim.pid, signal.SIGKILL)
        _, errors = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, errors
        assert members(marker) == set()
    whole = with_changes(tiny_overrides, *length, f"run.dir={tmp_path / 'whole'}")
    assert main(["train", *whole]) == 0
    assert summary(folder)["digest"] == summary(tmp_path / "whole")["digest"]


# --- Ctrl-C ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.flower
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc")
def test_ctrl_c_ends_a_simulation_with_what_it_has_learned_and_a_resume_goes_on(
    tmp_path: Path, tiny_overrides: Sequence[str]
) -> None:
    folder = tmp_path / "run"
    changes = ["train.max_ticks=null", "train.episodes=100000000", "runtime=simulation"]
    given = with_changes(tiny_overrides, *changes, "federation.clients=2", f"run.dir={folder}")
    process = start(given, tmp_path)
    with watched(process) as marker_of:
        wait_until(lambda: state_of(folder) == "training", process)
        marker = marker_of()
        process.send_signal(signal.SIGINT)
        printed, errors = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 130, errors
        assert "Stopped early by Ctrl-C" in printed
        found = summary(folder)
        assert found["stopped_early"]
        robots = load_file(folder / "weights.safetensors")["robots"]
        assert digest(robots) == found["digest"]["robots"]
        assert not (folder / "stop").exists()
        assert members(marker) == set()
    later = f"train.max_ticks={found['ticks'] + 30}"
    assert main(["train", f"resume={folder}", later]) == 0
    whole = with_changes(tiny_overrides, *changes[1:2], later, f"run.dir={tmp_path / 'whole'}")
    assert main(["train", *whole]) == 0
    assert summary(folder)["digest"] == summary(tmp_path / "whole")["digest"]


@pytest.mark.flower
@pytest.mark.slow
def test_a_killed_simulation_leaves_no_process_and_is_resumed_to_the_same_bits(
    tmp_path: Path, tiny_overrides: Sequence[str]
) -> None:
    folder = tmp_path / "run"
    length = ("train.max_ticks=3000", "train.episodes=100000000", "state.every=3")
    given = with_changes(tiny_overrides, *length, "runtime=simulation", f"run.dir={folder}")
    process = start(given, tmp_path)
    with watched(process) as marker_of:
        wait_until(lambda: len(checkpoints(server_folder(folder / "state"))) >= 2, process)
        marker = marker_of()
        process.kill()
        process.wait()
        wait_until(lambda: members(marker) == set())
    assert not (folder / "summary.json").exists()
    assert main(["train", f"resume={folder}"]) == 0
    whole = with_changes(tiny_overrides, *length, f"run.dir={tmp_path / 'whole'}")
    assert main(["train", *whole]) == 0
    assert summary(folder)["digest"] == summary(tmp_path / "whole")["digest"]


# --- Flower's own command -------------------------------------------------------------------------


@pytest.fixture
def flwr_home(tmp_path: Path) -> Iterator[dict[str, str]]:
    """The variables of a user's shell with a Flower home and ports of its own."""
    marker = uuid.uuid4().hex
    short = Path(f"/tmp/rf-{marker[:8]}")  # Ray's sockets lie below it: their paths must be short
    short.mkdir()
    variables = child_environment(short, marker)
    variables["FLWR_LOCAL_SUPERLINK_HTTP_API_PORT"] = str(free_port())
    variables["FLWR_LOCAL_CONTROL_API_PORT"] = str(free_port())
    yield variables
    terminate(marker)
    left = members(marker)
    shutil.rmtree(short, ignore_errors=True)
    assert left == set()


@pytest.mark.slow
@pytest.mark.flower
@pytest.mark.parametrize("app", [".", "hub"])
def test_flowers_own_command_ends_in_the_same_bits(
    tmp_path: Path,
    tiny_overrides: Sequence[str],
    expected: Expected,
    flwr_home: dict[str, str],
    project: Path,
    app: str,
) -> None:
    folder = tmp_path / "run"
    changes = [*LENGTH, "runtime=simulation", f"run.dir={folder}"]
    config = tmp_path / "run.toml"
    overrides = " ".join(with_changes(tiny_overrides, *changes))
    config.write_text(f"overrides = {json.dumps(overrides)}\n")
    command = [str(Path(sysconfig.get_path("scripts"), "flwr")), "run", "."]
    told = subprocess.run(
        [*command, "--run-config", str(config)],
        cwd=project / app,
        env=flwr_home,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert told.returncode == 0, told.stdout + told.stderr
    wait_until(lambda: state_of(folder) in ("done", "failed"))
    assert state_of(folder) == "done", (folder / "progress.json").read_text()
    assert summary(folder)["digest"] == expected()


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A clean copy of this project's files, as a fresh clone would have them."""
    kept = shutil.ignore_patterns(".*", "__pycache__", "runs", "multirun", "*.egg-info")
    copy = tmp_path / "project"
    shutil.copytree(ROOT, copy, ignore=kept)
    shutil.copy(ROOT / ".gitignore", copy)
    return copy


def test_the_bundle_of_a_fresh_clone_is_the_manifest_alone(project: Path) -> None:
    from flwr.cli.build import build_fab_from_disk

    names = zipfile.ZipFile(io.BytesIO(build_fab_from_disk(project))).namelist()
    assert [name for name in names if name.endswith((".py", ".yaml"))] == []
    assert "pyproject.toml" in names


# --- Larger fleets and failures -------------------------------------------------------------------


@pytest.mark.flower
@pytest.mark.slow
def test_sixteen_robots_share_the_clients_that_a_machine_can_run(
    tmp_path: Path, train: Train, sessions: list[Session], capsys: pytest.CaptureFixture[str]
) -> None:
    size = ["env.robots=16", "env.power.levels=16", "train.max_ticks=20", "federation.every=10"]
    assert train("local", *size, "runtime=local") == 0
    status = train("flower", *size, "runtime=simulation")
    assert status == 0, capsys.readouterr().err
    assert summary(tmp_path / "flower")["digest"] == summary(tmp_path / "local")["digest"]


BROKEN_CLIENT = """
from flwr.clientapp import ClientApp
app = ClientApp()
@app.train()
def train(message, context):
    raise ZeroDivisionError("the robots are out of order")
"""
BROKEN_SERVER = """
from flwr.serverapp import ServerApp
app = ServerApp()
@app.main()
def main(grid, context):
    raise ZeroDivisionError("the world is out of order")
"""


@pytest.mark.flower
@pytest.mark.slow
@pytest.mark.parametrize("side", ["client", "server"])
def test_an_app_that_raises_fails_the_run_with_its_reason(
    tmp_path: Path,
    train: Train,
    sessions: list[Session],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    side: str,
) -> None:
    code = tmp_path / "code"
    code.mkdir()
    (code / "broken_app.py").write_text(BROKEN_CLIENT if side == "client" else BROKEN_SERVER)
    monkeypatch.setenv("PYTHONPATH", str(code))
    parts = Components(**{side: "broken_app:app"})
    monkeypatch.setattr(superlink, "Components", lambda: parts)
    assert train("run", "runtime=simulation") == 1
    said = capsys.readouterr().err
    assert said.startswith("risfleet: ")
    assert "out of order" in said
    if side == "client":
        assert "robot" in said
        assert state_of(tmp_path / "run") == "failed"


@pytest.mark.flower
@pytest.mark.slow
def test_a_link_port_that_is_taken_after_the_check_fails_the_run_by_its_number(
    train: Train,
    sessions: list[Session],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("experiments.runtimes.runner.check_address", lambda config: None)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert train("run", "runtime=simulation", f"federation.link.port={port}") == 1
    said = capsys.readouterr().err
    assert f"federation.link.port={port}: allowed is a port that is free on 127.0.0.1" in said
    assert "Traceback" not in said
