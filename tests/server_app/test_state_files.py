"""State that is damaged, another's, or cannot be written: who is named, and how a run goes on."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import disks
import pytest
from fake_grid import FakeGrid

from client_app.robots import RobotGroup
from conf import Config
from experiments.cli import main
from lockstep import RobotFailed
from server_app.nodes import RoundError
from storage.checkpoint_files import checkpoints, load_checkpoint
from storage.checkpoint_layout import node_folder, robot_folder, server_folder
from training.checkpoint import latest

Tiny = Callable[..., Config]
RUN = "0123456789abcdef"
OTHER = "fedcba9876543210"
TICKS, LONGER = 75, 120


def newest_file(folder: Path) -> Path:
    """The newest checkpoint in a folder."""
    return folder / f"checkpoint-{checkpoints(folder)[-1]:012d}.safetensors"


def cut(path: Path, other: Path) -> None:
    path.write_bytes(path.read_bytes()[:-7])


def empty(path: Path, other: Path) -> None:
    path.write_bytes(b"")


def flip(path: Path, other: Path) -> None:
    content = bytearray(path.read_bytes())
    content[-11] ^= 4
    path.write_bytes(content)


def exchange(path: Path, other: Path) -> None:
    shutil.copy(other / path.name, path)


DAMAGES = [
    pytest.param(cut, "is cut short or damaged", id="truncated"),
    pytest.param(empty, "is cut short or damaged", id="empty", marks=pytest.mark.slow),
    pytest.param(flip, "was changed: its digest does not match", id="flipped"),
    pytest.param(exchange, f"is that of run {OTHER}, not of run {RUN}", id="another_run"),
]
Damage = Callable[[Path, Path], None]


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs that several tests go on from, each played when it is first wanted."""
    return tmp_path_factory.mktemp("stored")


@pytest.fixture(scope="module")
def expected(tiny_overrides: Any, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The digests of the run that nothing happens to."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    assert main(begun(tiny_overrides, folder, LONGER)) == 0
    return digests_of(folder)


# --- A deployment's, on its nodes and at its server -----------------------------------------------


@pytest.fixture
def fleet(deployed: Tiny, tmp_path: Path) -> Callable[..., tuple[Config, FakeGrid]]:
    """A federation whose nodes keep their robots' state in folders of their own."""

    def make(ticks: int, run: str = RUN, root: Path = tmp_path) -> tuple[Config, FakeGrid]:
        own = {"runtime.connection": "mine", "train.max_ticks": ticks, "run.id": run}
        own |= {"run.dir": str(root / "run")}
        if run == OTHER:
            own |= {"seed": 1, "run.dir": str(root / "other")}
        config = deployed(own)
        return config, FakeGrid(3, node_config=lambda k: {"state-dir": str(root / f"node-{k}")})

    return make


@pytest.fixture
def stopped(fleet: Any, run: Any, tmp_path: Path, stored: Path) -> Callable[..., None]:
    """Lays down what a run that was stopped has left, on its nodes and at its server."""

    def make(name: str = RUN) -> None:
        kept = stored / name
        if not kept.exists():
            run(*fleet(TICKS, name, kept))
        shutil.copytree(kept, tmp_path, dirs_exist_ok=True)

    return make


def own_folder(tmp_path: Path, robot: int, run: str = RUN) -> Path:
    """Where a robot's node has its checkpoints."""
    return robot_folder(node_folder(tmp_path / f"node-{robot}", run), robot)


@pytest.mark.parametrize(("damage", "says"), DAMAGES)
def test_a_robots_damaged_state_is_named_and_the_one_before_it_is_gone_on_from(
    fleet: Any,
    run: Any,
    stopped: Any,
    expected: dict[str, str],
    tmp_path: Path,
    caplog: Any,
    damage: Damage,
    says: str,
) -> None:
    config, grid = fleet(LONGER)
    stopped()
    if damage is exchange:
        stopped(OTHER)
    path = newest_file(own_folder(tmp_path, 1))
    before = checkpoints(path.parent)
    damage(path, own_folder(tmp_path, 1, OTHER))
    summary = run(config, grid, resumes=True)
    assert summary["digest"] == expected
    assert f"robot 1 cannot go on from window {before[-1]}: checkpoint {path} {says}" in caplog.text


@pytest.mark.parametrize(("damage", "says"), DAMAGES)
def test_the_servers_damaged_state_is_named_and_the_one_before_it_is_gone_on_from(
    fleet: Any,
    run: Any,
    stopped: Any,
    expected: dict[str, str],
    tmp_path: Path,
    damage: Damage,
    says: str,
) -> None:
    config, grid = fleet(LONGER)
    stopped()
    if damage is exchange:
        stopped(OTHER)
    state = tmp_path / "run" / "state"
    path = newest_file(server_folder(state))
    damage(path, server_folder(tmp_path / "other" / "state"))
    found = latest(state, 0, RUN)
    assert [f"checkpoint {path} {says}" in reason for reason in found.passed_over] == [True]
    assert found.window == checkpoints(path.parent)[-2]
    assert run(config, grid, resumes=True)["digest"] == expected


def test_a_robot_with_no_whole_state_is_named(
    fleet: Any, run: Any, stopped: Any, tmp_path: Path
) -> None:
    stopped()
    own = own_folder(tmp_path, 1)
    for path in own.rglob("*.safetensors"):
        cut(path, path)
    config, grid = fleet(LONGER)
    say = r"robot 0: .*4, 6, .*; robot 1: none; robot 2: .*4, 6, .*state-dir as it was\?"
    with pytest.raises(RoundError, match=say):
        run(config, grid, resumes=True)


def test_another_robots_state_is_not_taken_for_its_own(
    fleet: Any, run: Any, stopped: Any, expected: dict[str, str], tmp_path: Path, caplog: Any
) -> None:
    config, grid = fleet(LONGER)
    stopped()
    path = newest_file(own_folder(tmp_path, 1))
    shutil.copy(own_folder(tmp_path, 2) / path.name, path)
    assert run(config, grid, resumes=True)["digest"] == expected
    assert f"{path} is that of robot 2, not of robot 1" in caplog.text


# --- One process ----------------------------------------------------------------------------------


def begun(overrides: Any, folder: Path, ticks: int) -> list[str]:
    """The command's arguments for the tiny run of so many ticks."""
    return ["train", *overrides, f"train.max_ticks={ticks}", "state.every=2", f"run.dir={folder}"]


def digests_of(folder: Path) -> dict[str, str]:
    found: dict[str, str] = json.loads((folder / "summary.json").read_text())["digest"]
    return found


@pytest.mark.parametrize(("damage", "says"), DAMAGES)
@pytest.mark.parametrize("whose", ["server", pytest.param("robot-01", marks=pytest.mark.slow)])
def test_the_command_names_a_damaged_checkpoint_and_goes_on_from_the_one_before_it(
    tiny_overrides: Any,
    expected: dict[str, str],
    tmp_path: Path,
    capsys: Any,
    damage: Damage,
    says: str,
    whose: str,
    stored: Path,
) -> None:
    folder, other = tmp_path / "run", tmp_path / "other"
    if not (stored / "alone").exists():
        assert main([*begun(tiny_overrides, stored / "alone", 80), f"run.id={RUN}"]) == 0
    shutil.copytree(stored / "alone", folder)
    if damage is exchange:
        assert main([*begun([*tiny_overrides, "seed=1"], other, 80), f"run.id={OTHER}"]) == 0
    path = newest_file(folder / "state" / whose)
    damage(path, other / "state" / whose)
    capsys.readouterr()
    assert main(["train", f"resume={folder}", f"train.max_ticks={LONGER}"]) == 0
    printed = capsys.readouterr().out
    assert f"passed over: checkpoint {path} {says}" in printed
    assert "going on from window 6" in printed
    assert digests_of(folder) == expected


# --- Disks ----------------------------------------------------------------------------------------

mounts = pytest.mark.skipif(bool(disks.obstacle()), reason=disks.obstacle() or "none")


@pytest.fixture
def at_robots_tick(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Does something, once, before a robot is told of a tick."""

    def make(tick: int, robot: int, act: Callable[[], object]) -> None:
        step, left = RobotGroup.step, [1]

        def watched(self: RobotGroup, told: Any) -> Any:
            if told.tick == tick and robot in self.robots and left:
                left.pop()
                act()
            return step(self, told)

        monkeypatch.setattr(RobotGroup, "step", watched)

    return make


@pytest.fixture
def trouble(tmp_path: Path) -> Iterator[Callable[[str, Path], tuple[Any, Any]]]:
    """Makes a disk full or a folder read-only: the two calls that do it and undo it."""
    open_ones: list[AbstractContextManager[None]] = []

    def make(kind: str, folder: Path) -> tuple[Callable[[], None], Callable[[], None]]:
        def spoil() -> None:
            if kind == "full":
                disks.fill(folder)
                return
            open_ones.append(disks.read_only(folder))
            open_ones[-1].__enter__()

        def mend() -> None:
            if kind == "full":
                disks.free(folder)
            else:
                open_ones.pop().__exit__(None, None, None)

        return spoil, mend

    yield make
    while open_ones:
        open_ones.pop().__exit__(None, None, None)


SAYS = {"full": "No space left on device", "read_only": "Read-only file system"}


@mounts
@pytest.mark.parametrize("kind", list(SAYS))
def test_a_node_whose_disk_takes_nothing_ends_the_run_by_name_and_keeps_what_it_has(
    fleet: Any,
    run: Any,
    expected: dict[str, str],
    at_robots_tick: Any,
    trouble: Any,
    tmp_path: Path,
    kind: str,
) -> None:
    config, grid = fleet(LONGER)
    with disks.small_disk(tmp_path / "node-1"):
        spoil, mend = trouble(kind, tmp_path / "node-1")
        at_robots_tick(65, 1, spoil)
        with pytest.raises(RobotFailed) as failure:
            run(config, grid)
        own = own_folder(tmp_path, 1)
        assert str(failure.value).startswith("robot 1 failed at tick ")
        assert SAYS[kind] in str(failure.value)
        assert str(own / "checkpoint-") in str(failure.value)
        assert checkpoints(own) == [2, 4, 6]
        for window in checkpoints(own):
            load_checkpoint(own, window)
        assert not list(own.glob("*.writing"))
        mend()
        assert run(*fleet(LONGER), resumes=True)["digest"] == expected


@mounts
@pytest.mark.parametrize("kind", ["full", pytest.param("read_only", marks=pytest.mark.slow)])
@pytest.mark.parametrize("whose", ["robot-01", "server"])
def test_a_run_whose_disk_takes_nothing_says_which_file_and_how_to_go_on(
    tiny_overrides: Any,
    expected: dict[str, str],
    at_robots_tick: Any,
    trouble: Any,
    tmp_path: Path,
    capsys: Any,
    kind: str,
    whose: str,
) -> None:
    folder = tmp_path / "disk" / "run"
    with disks.small_disk(tmp_path / "disk"):
        spoil, mend = trouble(kind, folder / "state" / whose if kind != "full" else folder)
        at_robots_tick(55, 1, spoil)
        assert main(begun(tiny_overrides, folder, LONGER)) == 1
        said = capsys.readouterr().err.splitlines()
        assert said[0].startswith("risfleet: ")
        assert SAYS[kind] in said[0]
        assert str(folder) in said[0]
        if kind != "full":
            assert str(folder / "state" / whose / "checkpoint-") in said[0]
        assert said[1:] == [f"To go on: risfleet train resume={folder}"]
        mend()
        assert main(["train", f"resume={folder}"]) == 0
        assert digests_of(folder) == expected
