"""A federation on loopback, and one that runs already: who is started, watched and refused."""

from __future__ import annotations

import os
import signal
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from process_helpers import HEALTHY, wait_until

from conf import Config, compose
from experiments.flower import commands, control, federation, superlink
from experiments.flower.connection import Connection
from experiments.flower.control import RunState, Status
from experiments.flower.environment import FlowerError, ProcessLostError, UnansweredError
from experiments.flower.federation import Federation
from experiments.runtimes import on_flower
from repeatable.processes import MARKER, members
from storage.checkpoint_files import CheckpointError
from training.run_folder import RunFolder

pytestmark = [
    pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="finds processes in /proc"),
    pytest.mark.usefixtures("swift"),
]

SUPERNODE = """
    import subprocess, sys, time
    subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)", "flower-superexec"])
    time.sleep(600)
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], None]:
    """Puts a Python script in the place of one of Flower's commands, which notes its arguments."""

    def make(name: str, script: str) -> None:
        path = tmp_path / name
        note = f"""
        import os, sys
        with open({str(tmp_path / "started")!r}, "a") as file:
            print({name!r}, os.environ[{MARKER!r}], *sys.argv[1:], sep="|", file=file)
        """
        path.write_text(f"#!{sys.executable}\n{textwrap.dedent(note)}{textwrap.dedent(script)}")
        path.chmod(0o755)
        for module in (superlink, commands, federation):
            monkeypatch.setattr(module, "flower_command", lambda wanted: str(tmp_path / wanted))

    return make


@pytest.fixture
def running(
    tmp_path: Path, install: Callable[[str, str], None], monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., Federation]]:
    """Starts federations whose SuperLink answers and says of every run that it is going on."""
    install("flower-superlink", HEALTHY)
    install("flower-supernode", SUPERNODE)
    monkeypatch.setattr(control, "run_status", lambda *_: Status(RunState.RUNNING))
    opened: list[Federation] = []

    def make(**changes: object) -> Federation:
        made = Federation(**{"nodes": 2, "log_path": tmp_path / "log", **changes})
        opened.append(made.__enter__())
        return made

    yield make
    for made in opened:
        made.stop()
    for line in started(tmp_path):
        assert members(line[1]) == set()


def started(tmp_path: Path, name: str = "") -> list[list[str]]:
    """Commands that were started: name, marker, arguments."""
    path = tmp_path / "started"
    lines = path.read_text().splitlines() if path.exists() else []
    return [line.split("|") for line in lines if line.startswith(name)]


def complete(made: Federation) -> bool:
    """Whether every SuperNode has been seen with what starts its clients."""
    made.status(1)
    return all(node.executor.seen for node in made._nodes)


def test_every_supernode_has_a_place_and_a_port_of_its_own(
    running: Callable[..., Federation], tmp_path: Path
) -> None:
    running(nodes=3)
    wait_until(lambda: len(started(tmp_path, "flower-supernode")) == 3)
    lines = started(tmp_path, "flower-supernode")
    places = {line[line.index("--node-config") + 1] for line in lines}
    assert places == {f"partition-id={n} num-partitions=3" for n in range(3)}
    assert len({line[line.index("--port") + 1] for line in lines}) == 3
    assert len({line[line.index("--superlink") + 1] for line in lines}) == 1
    assert all("--insecure" in line for line in lines)


def test_a_supernode_that_dies_is_started_again(
    running: Callable[..., Federation], tmp_path: Path
) -> None:
    made = running()
    wait_until(lambda: complete(made))
    victim = made._nodes[1]
    os.kill(victim.process.pid, signal.SIGKILL)
    victim.process.wait()
    assert made.status(1).state is RunState.RUNNING
    wait_until(lambda: len(started(tmp_path, "flower-supernode")) == 3)
    assert "partition-id=1 num-partitions=2" in started(tmp_path, "flower-supernode")[-1]
    assert made._nodes[1].process.pid != victim.process.pid


def test_a_supernode_that_can_start_no_clients_any_more_is_replaced(
    running: Callable[..., Federation], tmp_path: Path
) -> None:
    made = running()
    wait_until(lambda: complete(made))
    node = made._nodes[0]
    (below,) = members(None, [node.root]) - {node.root}
    os.kill(below.pid, signal.SIGKILL)
    wait_until(lambda: below not in members(None, [node.root]))
    made.status(1)
    assert node.process.wait(10) != 0
    wait_until(lambda: len(started(tmp_path, "flower-supernode")) == 3)


def test_a_supernode_whose_starter_died_before_anybody_saw_it_is_replaced(
    running: Callable[..., Federation], install: Callable[[str, str], None], tmp_path: Path
) -> None:
    install("flower-supernode", SUPERNODE.replace('time.sleep(600)", "flower-superexec"', '0"'))
    made = running(nodes=1)
    node = made._nodes[0]

    def replaced() -> bool:
        made.status(1)
        return made._nodes[0] is not node

    wait_until(replaced)
    assert not node.executor.seen


def test_a_superlink_whose_starter_died_fails_a_run_that_has_not_begun(
    running: Callable[..., Federation],
    install: Callable[[str, str], None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    child = "import subprocess\nsubprocess.Popen([sys.executable, '-c', 'pass'])\n"
    install("flower-superlink", "import sys\n" + child + textwrap.dedent(HEALTHY))
    monkeypatch.setattr(control, "run_status", lambda *_: Status(RunState.PENDING))
    made = running(nodes=1)
    wait_until(lambda: made.status(1).state is RunState.FAILED)
    assert made.status(1).details == "Flower's SuperExec ended without a word"


def test_without_waiting_a_lost_supernode_fails_the_run_once_the_run_had_time_to_say_more(
    running: Callable[..., Federation], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    made = running(revive=False)
    wait_until(lambda: complete(made))
    os.kill(made._nodes[1].process.pid, signal.SIGKILL)
    made._nodes[1].process.wait()
    assert made.status(1).state is RunState.RUNNING
    monkeypatch.setattr(federation, "_LAST_WORDS_S", 0.0)
    assert made.status(1) == Status(RunState.FAILED, "SuperNode 1 ended with status -9")
    assert len(started(tmp_path, "flower-supernode")) == 2


def test_a_supernode_that_cannot_live_is_given_up(
    running: Callable[..., Federation], install: Callable[[str, str], None]
) -> None:
    install("flower-supernode", "sys.exit(3)")
    made = running(nodes=1)

    def for_ever() -> bool:
        made.status(1)
        return False

    with pytest.raises(FlowerError, match="SuperNode 0 ended with status 3 again and again"):
        wait_until(for_ever)


def test_a_server_app_that_died_unnoticed_fails_the_run(
    running: Callable[..., Federation], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = running(nodes=1)
    monkeypatch.setattr(federation, "_SERVER_APP", "flower-superlink")
    assert made.status(1).state is RunState.RUNNING
    monkeypatch.setattr(federation, "_SERVER_APP", "flwr-serverapp")
    assert made.status(1) == Status(RunState.FAILED, "the ServerApp's process ended without a word")


# --- A federation that runs already ---------------------------------------------------------------


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Flower's folder of a user who knows three SuperLinks."""
    monkeypatch.setenv("FLWR_HOME", str(tmp_path))
    (tmp_path / "config.toml").write_text(
        '[superlink]\ndefault = "near"\n'
        '[superlink.near]\naddress = "127.0.0.1:9"\ninsecure = true\n'
        '[superlink.open]\naddress = "192.0.2.7:8000"\ninsecure = true\n'
        '[superlink.safe]\naddress = "192.0.2.7:8000"\nroot-certificates = "ca.crt"\n'
    )
    return tmp_path


def test_an_insecure_connection_must_not_leave_this_machine(home: Path) -> None:
    Connection("near")
    Connection("safe")
    with pytest.raises(FlowerError, match=r"192\.0\.2\.7:8000 is not this machine"):
        Connection("open")


def test_an_unknown_connection_names_those_that_there_are(home: Path) -> None:
    with pytest.raises(FlowerError, match=r"runtime.connection=far: .*: near, open, safe"):
        Connection("far")
    (home / "config.toml").unlink()
    with pytest.raises(FlowerError, match=r"runtime.connection=far: .*config.toml cannot be read"):
        Connection("far")


@pytest.mark.parametrize(
    ("encoding", "said"),
    [
        ("utf-8-sig", "it begins with a byte order mark, which Flower does not read"),
        ("utf-16", "it is in UTF-16: save it as UTF-8"),
    ],
)
def test_a_file_of_flowers_that_it_cannot_read_is_named(
    home: Path, encoding: str, said: str
) -> None:
    path = home / "config.toml"
    path.write_text(path.read_text(encoding="utf-8"), encoding=encoding)
    with pytest.raises(FlowerError, match=f"config.toml cannot be read: {said}"):
        Connection("near")


# --- Starting again -------------------------------------------------------------------------------


class Attempts:
    """What takes the place of a whole run on Flower: an outcome each time."""

    def __init__(self, *outcomes: Exception | None) -> None:
        self.outcomes, self.resumed = list(outcomes), []  # type: ignore[var-annotated]

    def __call__(self, config: Config, folder: Path, resumes: bool) -> None:
        self.resumed.append(resumes)
        outcome = self.outcomes.pop(0)
        if outcome is not None:
            raise outcome


DIED = ProcessLostError("Flower's SuperLink ended with status -9.")


@pytest.fixture
def persevere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[[Attempts, list[int]], None]:
    """Plays attempts; after each that died the newest checkpoint is the next one of a list."""

    class Point:
        def __init__(self, window: int) -> None:
            self.window = window

    def make(attempts: Attempts, windows: list[int], on_loss: str = "wait") -> None:
        left = list(windows)

        def latest(state: Path, robots: int, run: str | None, *, rooms: bool) -> Point:
            window = left.pop(0)
            if not window:
                raise CheckpointError("none")
            return Point(window)

        monkeypatch.setattr(on_flower, "_run", attempts)
        monkeypatch.setattr(on_flower, "latest", latest)
        config = compose(["runtime=simulation", f"federation.on_loss={on_loss}"])
        on_flower._run_with_restarts(config, RunFolder(tmp_path), None)

    return make


def test_a_run_whose_processes_died_goes_on_from_its_last_checkpoint(
    persevere: Callable[..., None], tmp_path: Path
) -> None:
    attempts = Attempts(DIED, DIED, None)
    persevere(attempts, [20, 40])
    assert attempts.resumed == [False, True, True]
    assert "Starting again from window 40" in (tmp_path / "progress.json").read_text()


def test_a_run_that_died_before_its_first_checkpoint_begins_again(
    persevere: Callable[..., None], tmp_path: Path
) -> None:
    (tmp_path / "metrics.csv").touch()
    attempts = Attempts(DIED, None)
    persevere(attempts, [0])
    assert attempts.resumed == [False, False]
    assert not (tmp_path / "metrics.csv").exists()


def test_a_run_whose_processes_died_after_its_end_is_done(
    persevere: Callable[..., None], tmp_path: Path
) -> None:
    (tmp_path / "summary.json").write_text("{}")
    attempts = Attempts(DIED)
    persevere(attempts, [], on_loss="abort")
    assert attempts.resumed == [False]


def test_a_run_that_gets_nowhere_is_given_up(persevere: Callable[..., None]) -> None:
    attempts = Attempts(*[DIED] * 10)
    with pytest.raises(ProcessLostError, match="status -9"):
        persevere(attempts, [20] * 10)
    assert len(attempts.resumed) == 2 + on_flower.MOST_IN_VAIN


def test_what_is_no_loss_ends_the_run_at_once(persevere: Callable[..., None]) -> None:
    for error, on_loss in ((DIED, "abort"), (FlowerError("The run failed: ..."), "wait")):
        attempts = Attempts(error)
        with pytest.raises(FlowerError):
            persevere(attempts, [], on_loss)
        assert len(attempts.resumed) == 1


# --- Asking how it goes ---------------------------------------------------------------------------


class Asked:
    """A runner that answers in turn; what is no status is raised."""

    poll_s = 0.0

    def __init__(self, *answers: Status | Exception) -> None:
        self.answers = list(answers)

    def status(self, run_id: int) -> Status:
        answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if isinstance(answer, Exception):
            raise answer
        return answer


SILENT = UnansweredError("`flwr list` gave no answer within 60 s.")
DONE = Status(RunState.COMPLETED)


def test_questions_without_an_answer_are_no_end_of_a_run() -> None:
    asked = Asked(SILENT, Status(RunState.RUNNING), SILENT, SILENT, DONE)
    assert on_flower._awaited(asked, 1, 60.0) == DONE


def test_a_superlink_that_stays_silent_is_given_up() -> None:
    with pytest.raises(UnansweredError, match="no answer within"):
        on_flower._awaited(Asked(SILENT), 1, 0.05)


def test_what_flower_says_clearly_is_not_asked_again() -> None:
    for error in (DIED, FlowerError("SuperNode 0 ended with status 3 again and again.")):
        with pytest.raises(type(error)) as raised:
            on_flower._awaited(Asked(error, DONE), 1, 60.0)
        assert raised.value is error


@pytest.mark.parametrize("answer", ["", "no JSON", '{"success": true, "runs": []}'])
def test_a_command_that_tells_nothing_of_a_run_is_asked_again(
    home: Path, install: Callable[[str, str], None], answer: str
) -> None:
    install("flwr", f"print({answer!r})")
    with Connection("near") as connection, pytest.raises(UnansweredError):
        connection.status(1)


def test_a_log_that_cannot_be_had_hides_no_failure(
    home: Path, install: Callable[[str, str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    install("flwr", "import time; time.sleep(600)")
    monkeypatch.setattr(commands, "_TIMEOUT_S", 0.2)
    with Connection("near") as connection:
        assert connection.log_tail(1) == ""


def test_a_run_that_cannot_be_stopped_is_said_below_why_it_was_to_be(
    home: Path, install: Callable[[str, str], None]
) -> None:
    install("flwr", """print('{"success": false, "error-message": "unknown"}')""")
    with pytest.raises(ValueError, match="the reason") as raised, Connection("near") as connection:  # noqa: PT012
        connection._running = 7
        raise ValueError("the reason")
    assert raised.value.__notes__ == ["Run 7 may be going on: `flwr stop` failed.\nunknown"]


def test_a_full_disk_below_flowers_log_leaves_a_run_as_it_ended(
    running: Callable[..., Federation], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = running(nodes=1)
    made._submitted[1] = 0.0
    monkeypatch.setattr(control, "run_log", lambda *_: "much to say" * 1000)
    assert made._log is not None
    made._log.close()
    made._log = open("/dev/full", "ab")  # noqa: SIM115
    made.stop()


@pytest.mark.parametrize("progress", ["", "{", "[]", "7"])
def test_a_damaged_progress_file_does_not_hide_why_a_run_failed(
    tmp_path: Path, progress: str
) -> None:
    (tmp_path / "progress.json").write_text(progress)
    RunFolder(tmp_path).report_failure(ValueError("the reason"))
    assert "the reason" in (tmp_path / "progress.json").read_text()


@pytest.mark.parametrize(
    ("progress", "details", "lost"),
    [
        ("RobotLost: robot 1 lost at tick 3", "", True),
        ("RobotFailed: robot 1 failed at tick 3: OSError: no space", "", False),
        (None, "the simulation's process ended without a word", True),
        (None, "ServerApp failed with exception: no module named torch", False),
    ],
)
def test_a_lost_robot_or_process_is_told_from_a_failure(
    tmp_path: Path, progress: str | None, details: str, lost: bool
) -> None:
    if progress is not None:
        RunFolder(tmp_path).report_state("failed", progress)
    error = on_flower._failure(RunFolder(tmp_path), Status(RunState.FAILED, details), "the log")
    assert isinstance(error, ProcessLostError) is lost
    assert (progress or details) in str(error)
