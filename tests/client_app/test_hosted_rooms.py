"""A client's rooms: rounds, checkpoints in between, and rounds that are asked again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from client_app import rooms as rooms_module
from client_app.rooms import HostedRoom, RoomKeeper, held_rooms
from conf import Config, ap_network, robot_network
from conf.rooms import Room, rooms_of
from env.seeding import Stream, stream
from storage.checkpoint_files import CheckpointError, checkpoints, save_checkpoint
from storage.checkpoint_layout import room_folder
from training.recording.history import METRICS
from training.rooms import RoomReport, RoomTask, RoundTask

Building = Callable[..., Config]
Reports = Mapping[int, RoomReport]


def first(config: Config, index: int = 0) -> NDArray[np.float32]:
    """What all robots, or with index 1 access points, start from."""
    network = ap_network(config) if index else robot_network(config)
    return network.initial_pair(stream(config.seed, Stream.WEIGHTS, index))


def task(
    config: Config, number: int, since: int | None = None, *, keep: bool = True, count: int = 2
) -> RoundTask:
    """A round in the first rooms, from weights that differ from round to round."""
    rooms = rooms_of(config)[:count]
    before = number - 1 if since is None else since
    ap = None if before else first(rooms[0].config(config), 1)
    tasks = [RoomTask(room, before, ap) for room in rooms]
    model = first(rooms[0].config(config)) + np.float32(number / 100)
    return RoundTask(number, model, keep, tasks)


def equal(one: Reports, other: Reports) -> bool:
    """Whether reports agree bit for bit."""
    return one.keys() == other.keys() and all(same(one[k], other[k]) for k in one)


def same(one: RoomReport, other: RoomReport) -> bool:
    """Whether two reports of a room do."""
    return one.ticks == other.ticks and all(
        np.array_equal(a, b, equal_nan=True)
        for a, b in (
            (one.model, other.model),
            (one.ap, other.ap),
            (one.episodes, other.episodes),
        )
    )


@pytest.fixture(scope="module")
def config(tiny_building: Building) -> Config:
    return tiny_building()


@pytest.fixture(scope="module")
def played(config: Config) -> list[dict[int, RoomReport]]:
    """Three rounds in a row by one process that keeps nothing."""
    keeper = RoomKeeper(config, None)
    return [keeper.play(task(config, number, keep=False)) for number in (1, 2, 3)]


# --- One room -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"scheme.phase": "fixed"},
        {"strategy.name": "fedavgm", "strategy.momentum": 0.9, "train.worlds": 2},
        {"agent.learning_rate_end": 0.001, "agent.learning_rate_updates": 60},
    ],
)
def test_a_room_goes_on_from_its_state_to_the_same_bits(
    tiny_building: Building, changes: dict[str, Any]
) -> None:
    config = rooms_of(run := tiny_building(changes))[0].config(run)
    model = first(config)
    whole, restored = HostedRoom(config), HostedRoom(config)
    begun = whole.play(2, model)
    restored.restore({name: np.array(value) for name, value in whole.state().items()})
    reports = [room.play(3, begun.model) for room in (whole, restored)]
    assert same(*reports)
    assert reports[0].ticks == 25
    assert not np.array_equal(reports[0].model, begun.model)


def test_a_room_ends_in_the_bits_of_a_run_of_its_own(config: Config, play: Any) -> None:
    """Played in parts from what it has come to, and without them: Algorithm 1 either way."""
    own = rooms_of(config)[1].config(config)
    room, model, ap = HostedRoom(own), first(own), first(own, 1)
    for windows in (1, 3, 2):
        report = room.play(windows, model, ap)
        model, ap = report.model, None
    whole = play(replace(own, train=replace(own.train, max_ticks=30)))
    assert np.array_equal(whole.robots[0], report.model)


def test_episodes_have_a_row_each_with_the_rooms_own_ticks(config: Config) -> None:
    own = rooms_of(config)[0].config(config)
    room = HostedRoom(own)
    reports = [room.play(4, first(own)) for _ in range(2)]
    rows = [dict(zip(METRICS, row, strict=True)) for each in reports for row in each.episodes]
    assert [row["episode"] for row in rows] == list(range(1, len(rows) + 1))
    assert len(rows) >= 3
    assert np.cumsum([row["slots"] for row in rows]).tolist() == [row["tick"] for row in rows]
    assert all(len(each.episodes) for each in reports)


def test_an_access_point_takes_a_network_only_where_it_is_given_one(config: Config) -> None:
    own = rooms_of(config)[0].config(config)
    given, kept = HostedRoom(own), HostedRoom(own)
    other = first(own, 1) + np.float32(0.5)
    reports = [given.play(1, first(own), other), kept.play(1, first(own))]
    assert not np.array_equal(reports[0].ap, reports[1].ap)
    assert np.abs(reports[0].ap - other).max() < 0.4
    assert reports[0].ap.shape == other.shape


def test_an_access_point_that_learns_nothing_has_no_network(tiny_building: Building) -> None:
    run = tiny_building({"scheme.phase": "random"})
    own = rooms_of(run)[0].config(run)
    report = HostedRoom(own).play(1, first(own), np.zeros((2, 0), np.float32))
    assert report.ap.shape == (2, 0)


# --- Rounds ---------------------------------------------------------------------------------------


def test_rooms_play_different_things(played: list[Reports]) -> None:
    assert [sorted(reports) for reports in played] == [[0, 1]] * 3
    assert [reports[0].ticks for reports in played] == [10, 20, 30]
    assert not np.array_equal(played[0][0].model, played[0][1].model)


def test_a_process_that_is_started_anew_goes_on_from_checkpoints(
    config: Config, played: list[Reports], tmp_path: Path
) -> None:
    for number, expected in enumerate(played, 1):
        assert equal(RoomKeeper(config, tmp_path).play(task(config, number)), expected)


@pytest.mark.parametrize("again", [1, 2])
def test_a_round_that_is_asked_again_is_played_to_the_same_bits(
    config: Config, played: list[Reports], tmp_path: Path, again: int
) -> None:
    """Its reply was lost: by the process that played it, which is a round ahead."""
    keeper = RoomKeeper(config, tmp_path)
    for number in range(1, again + 1):
        keeper.play(task(config, number))
    for number in range(again, 4):
        assert equal(keeper.play(task(config, number)), played[number - 1])


def test_rounds_that_a_room_missed_leave_it_as_it_was(
    config: Config, played: list[Reports], tmp_path: Path
) -> None:
    keeper = RoomKeeper(config, tmp_path)
    keeper.play(task(config, 1))
    late = keeper.play(task(config, 7, since=1))
    fresh = RoomKeeper(config, tmp_path).play(task(config, 7, since=1))
    assert equal(late, fresh)
    assert late[0].ticks == played[1][0].ticks == 20


def test_a_room_whose_replies_are_lost_again_and_again_keeps_what_it_goes_back_to(
    config: Config, tmp_path: Path
) -> None:
    keeper = RoomKeeper(config, tmp_path)
    keeper.play(task(config, 1))
    reports = [keeper.play(task(config, number, since=1)) for number in range(2, 9)]
    assert [report[0].ticks for report in reports] == [20] * 7
    assert checkpoints(room_folder(tmp_path, "0000")) == [1, 8]


def test_a_round_that_an_error_ends_half_way_leaves_no_trace(
    config: Config, played: list[Reports], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keeper = RoomKeeper(config, tmp_path)
    keeper.play(task(config, 1))
    play_all = HostedRoom.play

    def half(self: HostedRoom, windows: int, *given: Any) -> RoomReport:
        play_all(self, windows - 1, *given)
        raise MemoryError("no memory is left")

    with monkeypatch.context() as patch:
        patch.setattr(HostedRoom, "play", half)
        with pytest.raises(MemoryError):
            keeper.play(task(config, 2))
    assert equal(keeper.play(task(config, 2)), played[1])


def test_rooms_that_are_told_to_keep_nothing_write_when_they_are_told_to(
    config: Config, played: list[Reports], tmp_path: Path
) -> None:
    keeper = RoomKeeper(config, tmp_path)
    keeper.play(task(config, 1, keep=False))
    keeper.play(task(config, 2, keep=False, count=1))
    assert held_rooms(tmp_path, 3) == []
    keeper.keep()
    steps = [checkpoints(room_folder(tmp_path, name)) for name in ("0000", "0001")]
    assert steps == [[2], [1]]
    assert equal(RoomKeeper(config, tmp_path).play(task(config, 3, count=1)), {0: played[2][0]})


def test_a_room_that_has_not_played_since_is_not_written_again(
    config: Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keeper = RoomKeeper(config, tmp_path)
    written: list[int] = []

    def noted(folder: Path, step: int, *rest: Any) -> Path:
        written.append(step)
        return save_checkpoint(folder, step, *rest)

    monkeypatch.setattr(rooms_module, "save_checkpoint", noted)
    keeper.play(task(config, 1, keep=False))
    keeper.keep()
    keeper.play(task(config, 2, keep=False, count=1))
    keeper.keep()
    assert written == [1, 1, 2]


def test_without_a_folder_nothing_is_kept(config: Config) -> None:
    keeper = RoomKeeper(config, None)
    keeper.play(task(config, 1))
    keeper.keep()
    assert keeper.kept == {}


# --- Checkpoints that are not as they should be ---------------------------------------------------


@pytest.fixture
def kept(config: Config, tmp_path: Path) -> Path:
    """The only checkpoint of room 0, after round 1."""
    RoomKeeper(config, tmp_path).play(task(config, 1, count=1))
    [path] = room_folder(tmp_path, "0000").iterdir()
    return path


def test_a_missing_checkpoint_is_named(config: Config, kept: Path, tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"there is no checkpoint .*0000.*000002"):
        RoomKeeper(config, tmp_path).play(task(config, 3))
    with pytest.raises(CheckpointError, match="there is no checkpoint"):
        RoomKeeper(config, None).play(task(config, 2))


def test_a_damaged_checkpoint_is_named(config: Config, kept: Path, tmp_path: Path) -> None:
    content = bytearray(kept.read_bytes())
    content[-3] ^= 1
    kept.write_bytes(content)
    with pytest.raises(CheckpointError, match="digest does not match"):
        RoomKeeper(config, tmp_path).play(task(config, 2, count=1))


def test_a_checkpoint_of_another_run_is_not_taken(tiny_building: Building, tmp_path: Path) -> None:
    one, other = (tiny_building({"run.id": name * 16}) for name in "ab")
    RoomKeeper(one, tmp_path).play(task(one, 1, count=1))
    with pytest.raises(CheckpointError, match="is that of run a"):
        RoomKeeper(other, tmp_path).play(task(other, 2, count=1))


def test_held_rooms_are_those_with_a_checkpoint(kept: Path, tmp_path: Path) -> None:
    save_checkpoint(room_folder(tmp_path, "0002"), 4, {}, {})
    room_folder(tmp_path, "0003").mkdir()
    save_checkpoint(room_folder(tmp_path, Room(1, True, 0, {}).name), 4, {}, {})
    assert held_rooms(tmp_path, 9) == [0, 2]
    assert held_rooms(tmp_path, 2) == [0]
    assert held_rooms(tmp_path / "nowhere", 9) == []
