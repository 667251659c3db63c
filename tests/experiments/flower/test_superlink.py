"""The launcher of the simulation runtime: clear errors, no waits without end, nothing left over."""

from __future__ import annotations

import io
import os
import signal
import socket
import subprocess
import sys
import textwrap
import tomllib
import zipfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil  # type: ignore[import-untyped]
import pytest
from process_helpers import HEALTHY, wait_until

from experiments.flower import commands, control, environment, superlink
from experiments.flower.control import ControlError, RunState, Status
from experiments.flower.engine import SimulationSuperLink
from experiments.flower.environment import FlowerError, ProcessLostError
from experiments.flower.manifest import Components, write_manifest, write_run_config
from experiments.flower.session import Session
from repeatable import processes
from repeatable.processes import MARKER, Process, members, terminate
from training.engine_limits import max_concurrent_clients

pytestmark = pytest.mark.usefixtures("unguarded")
needs_proc = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc")


@pytest.fixture
def fake(
    tmp_path: Path, swift: None, monkeypatch: pytest.MonkeyPatch
) -> Callable[[str, str], None]:
    """Puts a Python script in the place of one of Flower's commands."""

    def install(name: str, script: str) -> None:
        path = tmp_path / name
        note = f"import os; open({str(tmp_path / 'marker')!r}, 'w').write(os.environ[{MARKER!r}])"
        path.write_text(f"#!{sys.executable}\n{note}\n{textwrap.dedent(script)}")
        path.chmod(0o755)
        for module in (superlink, commands):
            monkeypatch.setattr(module, "flower_command", lambda wanted: str(tmp_path / wanted))

    return install


@pytest.fixture
def healthy(tmp_path: Path, fake: Callable[[str, str], None]) -> Iterator[SimulationSuperLink]:
    """A launcher whose SuperLink answers and does nothing else."""
    fake("flower-superlink", HEALTHY)
    with SimulationSuperLink(log_path=tmp_path / "log") as running:
        yield running


def marker_of(tmp_path: Path) -> str:
    return (tmp_path / "marker").read_text()


# --- Processes ---


def start_tree(marker: str, leaf: str) -> subprocess.Popen[bytes]:
    """A marked process, below it one in a session of its own, below that a leaf."""
    middle = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {leaf!r}])"
    top = (
        "import subprocess, sys;"
        f"subprocess.run([sys.executable, '-c', {middle!r}], start_new_session=True)"
    )
    return subprocess.Popen([sys.executable, "-c", top], env={**os.environ, MARKER: marker})


@needs_proc
def test_a_process_that_ignores_the_request_to_end_is_killed() -> None:
    leaf = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(600)"
    top = start_tree("stubborn", leaf)
    wait_until(lambda: len(members("stubborn")) == 3)
    assert terminate("stubborn", grace_s=0.2) == set()
    assert members("stubborn") == set()
    assert top.wait() != 0


@needs_proc
def test_a_process_is_found_by_its_marker_after_its_parents_are_gone() -> None:
    top = start_tree("orphan", "import time; time.sleep(600)")
    wait_until(lambda: len(members("orphan")) == 3)
    for row in sorted(members("orphan"), key=lambda row: row.pid)[:2]:
        os.kill(row.pid, signal.SIGKILL)
    top.wait()
    wait_until(lambda: len(members("orphan")) == 1)
    assert terminate("orphan") == set()
    assert members("orphan") == set()


@needs_proc
def test_a_process_that_shows_its_marker_late_is_ended_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looks = []
    environment = processes.environment

    def late(pid: int) -> Mapping[str, str]:
        looks.extend([pid] if pid == child.pid else [])
        return environment(pid) if len(looks) > 2 else {}

    child = subprocess.Popen(["sleep", "600"], env={**os.environ, MARKER: "late"})
    try:
        wait_until(lambda: members("late") != set())
        monkeypatch.setattr(processes, "environment", late)
        assert terminate("late") == set()
        assert child.poll() is not None
    finally:
        child.kill()
        child.wait()


@needs_proc
def test_a_process_without_the_marker_is_found_below_one_that_has_it() -> None:
    bare = "import os, sys; os.execve(sys.executable, ['p', '-c', 'input()'], {})"
    script = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {bare!r}])"
    top = subprocess.Popen(
        [sys.executable, "-c", script],
        env={**os.environ, MARKER: "bare"},
        stdin=subprocess.PIPE,
    )
    wait_until(lambda: len(members("bare")) == 2)
    assert terminate("bare") == set()
    top.communicate()


def test_a_process_whose_number_was_given_to_another_is_left_alone() -> None:
    bystander = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    assert terminate(None, [Process(bystander.pid, "another start")]) == set()
    assert bystander.poll() is None
    bystander.communicate(b"\n")


def test_a_process_is_the_same_at_every_look_and_gone_after_its_end() -> None:
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    row = processes.identify(child.pid)
    assert row is not None
    assert row.parent == os.getpid()
    assert processes.table()[child.pid] == row
    assert row in members(None, [row])
    child.kill()
    wait_until(lambda: processes.table()[child.pid].zombie)
    assert members(None, [row]) == set()
    child.communicate()
    assert processes.identify(child.pid) is None
    assert (processes.command(row), processes.environment(child.pid)) == ("", {})


@needs_proc
def test_the_start_of_a_process_does_not_move_with_the_clock(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before, booted_s = processes.identify(os.getpid()), psutil.boot_time()
    monkeypatch.setattr("psutil._pslinux.boot_time", lambda: booted_s + 3600.0)
    assert processes.identify(os.getpid()) == before
    assert processes.table()[os.getpid()] == before


# --- Session ---


def test_stopping_a_session_removes_its_folder_and_can_be_repeated() -> None:
    session = Session()
    child = session.spawn([sys.executable, "-c", "import time; time.sleep(600)"], subprocess.PIPE)
    assert session.folder.is_dir()
    session.stop()
    session.stop()
    assert child.returncode is not None
    assert not session.folder.exists()


def test_a_command_that_gives_no_answer_is_ended_with_an_error() -> None:
    session = Session()
    try:
        with pytest.raises(FlowerError, match="gave no answer"):
            session.run([sys.executable, "-c", "import time; time.sleep(600)"], timeout_s=0.1)
    finally:
        session.stop()


@needs_proc
def test_a_session_whose_owner_is_killed_is_cleaned_up() -> None:
    owner = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import subprocess, sys, time\n"
            "from experiments.flower.session import Session\n"
            "session = Session()\n"
            "session.spawn([sys.executable, '-c', 'import time; time.sleep(600)'], 2)\n"
            "print(session.marker, session.folder, flush=True)\n"
            "time.sleep(600)",
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert owner.stdout is not None
    marker, folder = owner.stdout.readline().split()
    assert len(members(marker)) == 1
    owner.kill()
    owner.communicate()
    wait_until(lambda: not members(marker) and not Path(folder).exists())


# --- Starting the SuperLink ---


def test_a_port_in_use_is_named_before_anything_starts(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with (
            pytest.raises(FlowerError, match=f"Port {port} on 127.0.0.1 is in use"),
            SimulationSuperLink(log_path=tmp_path / "log", port=port),
        ):
            pass


def test_a_superlink_that_dies_at_its_start_shows_its_last_words(
    tmp_path: Path, fake: Callable[[str, str], None]
) -> None:
    fake("flower-superlink", "import sys; print('\\033[91mthe reason'); sys.exit(3)")
    launcher = SimulationSuperLink(log_path=tmp_path / "log")
    with pytest.raises(FlowerError, match=r"(?s)ended with status 3\.\nthe reason$"), launcher:
        pass
    assert members(marker_of(tmp_path)) == set()


def test_a_superlink_that_never_answers_is_ended(
    tmp_path: Path, fake: Callable[[str, str], None]
) -> None:
    fake("flower-superlink", "import time; time.sleep(600)")
    launcher = SimulationSuperLink(log_path=tmp_path / "log", start_timeout_s=0.6)
    with pytest.raises(FlowerError, match="did not answer within 1 s"), launcher:
        pass
    assert members(marker_of(tmp_path)) == set()


def test_another_port_is_taken_where_one_is_lost_in_between(
    tmp_path: Path, fake: Callable[[str, str], None]
) -> None:
    first = f"""
    from pathlib import Path
    if not (once := Path({str(tmp_path / "once")!r})).exists():
        once.touch()
        raise SystemExit("error while attempting to bind: address already in use")
    """
    fake("flower-superlink", textwrap.dedent(first) + textwrap.dedent(HEALTHY))
    with SimulationSuperLink(log_path=tmp_path / "log"):
        assert (tmp_path / "once").exists()
    assert members(marker_of(tmp_path)) == set()


def test_a_missing_flower_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("experiments.flower.environment.shutil.which", lambda *_, **__: None)
    with pytest.raises(FlowerError, match="flower-superlink is missing"):
        environment.flower_command("flower-superlink")


# --- Handing in a run ---


def test_the_limit_of_clients_is_that_of_a_default_thread_pool() -> None:
    with ThreadPoolExecutor() as pool:
        assert max_concurrent_clients() == pool._max_workers


@pytest.mark.parametrize("excess", [True, False])
def test_too_many_or_no_clients_are_refused(tmp_path: Path, excess: bool) -> None:
    clients = max_concurrent_clients() + 1 if excess else 0
    with pytest.raises(FlowerError, match=f"federation.clients is {clients}"):
        SimulationSuperLink(clients=clients, log_path=tmp_path / "log")


def test_flowers_own_reason_is_shown_when_it_refuses_a_run(
    healthy: SimulationSuperLink, fake: Callable[[str, str], None]
) -> None:
    fake("flwr", """print('{"success": false, "error-message": "no such module"}')""")
    with pytest.raises(FlowerError, match=r"`flwr run` failed\.\nno such module"):
        healthy.submit("")


@pytest.mark.parametrize("text", ["", "a=1 'b=[2, \"x\"]'", "d=C:\\runs\n\t\x7f\x01", "ü 🤖"])
def test_overrides_arrive_unchanged(tmp_path: Path, text: str) -> None:
    path = write_run_config(tmp_path / "run.toml", text)
    assert tomllib.loads(path.read_text(encoding="utf-8")) == {"overrides": text}


def test_the_submitted_bundle_is_a_valid_app_and_carries_no_code(tmp_path: Path) -> None:
    from flwr.cli.build import build_fab_from_disk
    from flwr.cli.config_utils import load_and_validate

    app = write_manifest(tmp_path / "app", Components("json:__all__", "json:__all__"))
    _, warnings = load_and_validate(app / "pyproject.toml", check_module=False)
    names = zipfile.ZipFile(io.BytesIO(build_fab_from_disk(app))).namelist()
    assert warnings == []
    assert {name for name in names if not name.startswith(".info/")} == {"pyproject.toml"}


# --- Asking after it ---


def test_the_command_is_asked_where_the_control_api_is_not_understood(
    healthy: SimulationSuperLink, fake: Callable[[str, str], None]
) -> None:
    row = '{"status": "finished:failed", "status-details": "x"}'
    fake("flwr", f"""print('{{"success": true, "runs": [{row}]}}')""")
    assert healthy.status(7) == Status(RunState.FAILED, "x")


def test_a_status_that_flower_does_not_document_is_an_error() -> None:
    with pytest.raises(ControlError, match="odd"):
        control.parse_status("odd", "")


def test_a_superlink_that_dies_later_is_an_error(
    healthy: SimulationSuperLink, tmp_path: Path
) -> None:
    (row,) = members(marker_of(tmp_path))
    os.kill(row.pid, signal.SIGKILL)
    wait_until(lambda: not members(marker_of(tmp_path)))
    with pytest.raises(FlowerError, match="ended with status -9"):
        healthy.status(1)


def test_a_superlink_that_dies_while_it_is_asked_is_a_lost_process(
    healthy: SimulationSuperLink, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def dies(session: Session, run_id: int) -> Status:
        (row,) = members(marker_of(tmp_path))
        os.kill(row.pid, signal.SIGKILL)
        wait_until(lambda: not members(marker_of(tmp_path)))
        raise FlowerError("`flwr list` failed.")

    monkeypatch.setattr(commands, "run_status", dies)
    with pytest.raises(ProcessLostError, match="ended with status -9"):
        healthy.status(1)


@needs_proc
def test_an_engine_that_died_unnoticed_fails_the_run(
    healthy: SimulationSuperLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control, "run_status", lambda *_: Status(RunState.RUNNING))
    assert healthy.status(1).state is RunState.FAILED


@pytest.mark.parametrize(
    ("state", "message"),
    [(RunState.PENDING, "still pending"), (RunState.RUNNING, "No client process has started")],
)
@needs_proc
def test_a_run_that_does_not_get_going_is_an_error(
    healthy: SimulationSuperLink, monkeypatch: pytest.MonkeyPatch, state: RunState, message: str
) -> None:
    monkeypatch.setattr(control, "run_status", lambda *_: Status(state))
    monkeypatch.setattr("experiments.flower.engine._SIMULATION", "flower-superlink")
    assert healthy.status(1).state is state
    healthy._submitted[1] = -1e9
    with pytest.raises(FlowerError, match=message):
        healthy.status(1)


# --- The real thing ---

SERVER = """
import time
from flwr.app import Message, RecordDict
from flwr.serverapp import ServerApp
app = ServerApp()
@app.main()
def main(grid, context):
    while len(nodes := list(grid.get_node_ids())) < 2:  # they are registered while this runs
        time.sleep(0.05)
    ask = [Message(RecordDict(), dst_node_id=n, message_type="train") for n in nodes]
    answers = list(grid.send_and_receive(ask, timeout=120))
    good = sum(not answer.has_error() for answer in answers)
    print(f"{good} clients answered, told: {context.run_config['overrides']}")
"""
CLIENT = """
from flwr.app import Message, RecordDict
from flwr.clientapp import ClientApp
app = ClientApp()
@app.train()
def train(message, context):
    return Message(RecordDict(), reply_to=message)
"""


@pytest.mark.slow
@pytest.mark.flower
def test_a_run_reaches_its_clients_and_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = tmp_path / "code"
    code.mkdir()
    (code / "tiny_server.py").write_text(SERVER)
    (code / "tiny_client.py").write_text(CLIENT)
    monkeypatch.setenv("PYTHONPATH", str(code))
    monkeypatch.chdir(tmp_path)
    with SimulationSuperLink(clients=2, log_path=tmp_path / "run" / "flower.log") as launcher:
        assert launcher._session is not None
        marker, folder = launcher._session.marker, launcher._session.folder
        parts = Components("tiny_server:app", "tiny_client:app")
        run = launcher.submit("a='b c'", parts)
        wait_until(lambda: launcher.status(run).finished)
        assert launcher.status(run) == Status(RunState.COMPLETED)
        assert "2 clients answered, told: a='b c'" in launcher.log_tail(run)
    assert members(marker) == set()
    assert not folder.exists()
    assert "2 clients answered" in (tmp_path / "run" / "flower.log").read_text()
