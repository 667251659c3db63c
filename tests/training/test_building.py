"""A building: averages across rooms, rooms that miss rounds, and runs that go on."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from building_helpers import LossyRooms, StandIns
from resume_helpers import summary

from conf import Config, ConfigError, ap_network, robot_network
from conf.rooms import from_json, rooms_of
from env.seeding import Stream, stream
from experiments.cli import main
from experiments.runtimes import local
from storage.checkpoint_files import CheckpointError, checkpoints, digest
from storage.checkpoint_layout import room_folder, server_folder
from tools.chaos.verdict import rows_of
from training.building import BuildingRun
from training.checkpoint import latest
from training.recording.history import EVALUATIONS, MEASURES
from training.room_recording import ROOM_METRICS, ROOMS
from training.rooms import known_rooms
from training.run_folder import RunFolder

Building = Callable[..., Config]
Summary = dict[str, Any]
QUIET = {
    "evaluation.every": 10**6,
    "evaluation.episodes": 1,
    "rooms.held_out": 0,
    "state.every": None,
}
"""An evaluation at the end alone, and a short one; nothing is kept."""

GOES_ON = {"train.max_ticks": 50, "evaluation.every": 5, "rooms.held_out": 1}


def records(folder: Path) -> list[list[dict[str, str]]]:
    return [rows_of(folder / name) for name in ("metrics.csv", "rooms.csv", "evaluations.csv")]


def trained(
    tiny_building: Building,
    path: Path,
    changes: dict[str, Any] | None = None,
    lost: dict[int, tuple[int, ...]] | None = None,
    host: Any = None,
    backwards: bool = False,
) -> tuple[Summary, Any]:
    """Trains a building in a folder with a host; returns summary and host."""
    folder = RunFolder(path)
    config = tiny_building({**QUIET, **(changes or {}), "run.dir": str(path)})
    state = None if config.state.every is None else folder.state
    if host is None:
        host = LossyRooms(config, state, lost or {})
        host.backwards = backwards
    BuildingRun(config, folder).train(host)
    return summary(path), host


@pytest.fixture
def build(tiny_building: Building, tmp_path: Path) -> Callable[..., tuple[Summary, Any]]:
    """Trains a building in a folder of this name; see ``trained``."""
    return lambda name, *rest, **named: trained(tiny_building, tmp_path / name, *rest, **named)


@pytest.fixture(scope="module")
def plain(tiny_building: Building, tmp_path_factory: pytest.TempPathFactory) -> tuple[Summary, Any]:
    """A building to which nothing happens; not to be changed."""
    return trained(tiny_building, tmp_path_factory.mktemp("plain") / "run")


@pytest.fixture(scope="module")
def one_missing(
    tiny_building: Building, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Summary, Any]:
    """A building whose room 1 misses every round, and its folder; not to be changed."""
    folder = tmp_path_factory.mktemp("missing") / "run"
    return folder, *trained(tiny_building, folder, {}, dict.fromkeys(range(1, 5), (1,)))


@pytest.fixture(scope="module")
def whole_building(
    tiny_building: Building, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Summary]:
    """A building of five rounds that nothing interrupts, and its folder; not to be changed."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    return folder, trained(tiny_building, folder, {**GOES_ON, "state.every": 4})[0]


@pytest.fixture
def resume(tmp_path: Path) -> Callable[..., Summary]:
    """Goes on with a building, with another host."""

    def make(name: str, lost: dict[int, tuple[int, ...]] | None = None, **train: Any) -> Summary:
        import dataclasses

        folder = RunFolder(tmp_path / name)
        config = folder.read_config()
        config = dataclasses.replace(config, train=dataclasses.replace(config.train, **train))
        host = LossyRooms(config, folder.state, lost or {})
        folder.stop_file.unlink(missing_ok=True)
        BuildingRun(config, folder, latest(folder.state, 0)).train(host)
        return summary(folder.path)

    return make


# --- What a run leaves behind ---------------------------------------------------------------------


def test_every_episode_of_any_room_has_a_row(building_run: Path) -> None:
    found, told = rows_of(building_run / "metrics.csv"), summary(building_run)
    assert tuple(found[0]) == ROOM_METRICS
    for room in range(3):
        own = [row for row in found if row["room"] == str(room)]
        assert [int(row["episode"]) for row in own] == list(range(1, len(own) + 1))
        assert len(own) == told["rooms"]["episodes"][room] >= 3
        assert np.cumsum([int(row["slots"]) for row in own]).tolist() == [
            int(row["tick"]) for row in own
        ]
    assert {row["room"] for row in found} == {"0", "1", "2"}
    assert told["episodes"] == sum(told["rooms"]["episodes"]) // 3


def test_every_evaluation_has_two_rows_for_each_room_and_their_mean(building_run: Path) -> None:
    found = rows_of(building_run / "rooms.csv")
    means = rows_of(building_run / "evaluations.csv")
    assert tuple(found[0]) == ROOMS
    assert len(means) >= 2
    assert len(found) == 8 * (len(means) // 2 + 1)  # and one at the end
    keys = [(row["held_out"], row["room"]) for row in found[:8:2]]
    assert keys == [("0", "0"), ("0", "1"), ("0", "2"), ("1", "0")]
    assert [row["epsilon"] for row in found[:2]] == ["0.05", "0.0"]
    for at, mean in enumerate(means):
        own = found[8 * (at // 2) :][at % 2 : 6 : 2]
        assert [row["held_out"] for row in own] == ["0"] * 3
        for name in ("success", "ee", "sum_rate"):
            expected = np.mean([float(row[name]) for row in own])
            assert float(mean[name]) == pytest.approx(expected)
        assert {row["tick"] for row in own} == {mean["tick"]}
        assert int(mean["tick"]) == 10 * int(own[0]["round"])


def test_the_summary_says_what_the_rooms_came_to(building_run: Path) -> None:
    told = summary(building_run)
    last = rows_of(building_run / "rooms.csv")[-8:]
    assert (told["ticks"], told["windows"]) == (40, 8)
    rooms = told["rooms"]
    assert (rooms["count"], rooms["robots"], rooms["ticks"]) == (3, 6, [40] * 3)
    for kind, own in (("trained_in", last[1:6:2]), ("held_out", last[7:])):
        for name in ("success", "ee"):
            mean = np.mean([float(row[name]) for row in own])
            assert rooms[kind][name] == pytest.approx(mean)
    assert told["evaluation"]["greedy"] == {
        name: rooms["trained_in"][name] for name in MEASURES
    } or np.isnan(rooms["trained_in"]["path_ratio"])
    assert not told["stopped_early"]
    assert tuple(rows_of(building_run / "evaluations.csv")[0]) == tuple(
        name for name in EVALUATIONS if name != "cpu_s"
    )


def test_each_room_has_a_folder_with_its_configuration_and_weights(building_run: Path) -> None:
    folder = RunFolder(building_run)
    config = folder.read_config()
    rooms = known_rooms(config, folder)
    assert rooms == rooms_of(config) == from_json(folder.rooms_file.read_text())
    found = [folder.room(room.name).read_networks(room.config(config)) for room in rooms]
    told = summary(building_run)["digest"]
    for robots, _ in found:
        assert robots.shape[0] == 2
        assert {digest(each) for each in robots} == {told["robots"]}
    assert digest(np.concatenate([ap.ravel() for _, ap in found[:3]])) == told["ap"]
    start = ap_network(rooms[0].config(config)).initial_weights(
        stream(config.seed, Stream.WEIGHTS, 1)
    )
    assert np.array_equal(found[3][1][0], start)  # nobody has trained there
    assert not np.array_equal(found[0][1][0], start)
    for room in rooms:
        assert folder.room(room.name).read_config() == room.config(config)


def test_progress_and_figure_are_there(building_run: Path) -> None:
    import matplotlib.image

    status = json.loads((building_run / "progress.json").read_text())
    assert status["state"] == "done"
    assert status["rooms"] == {"count": 3, "took_part": 3, "missing": []}
    assert [path.name for path in (building_run / "figures").iterdir()] == ["rooms.png"]
    pixels = matplotlib.image.imread(building_run / "figures" / "rooms.png")
    assert min(pixels.shape[:2]) > 300
    assert pixels[..., :3].std() > 0.01
    assert RunFolder(building_run).has_ended


# --- Averages -------------------------------------------------------------------------------------


def test_rooms_start_from_the_mean_of_what_all_have_come_to(plain: tuple[Summary, Any]) -> None:
    told, host = plain
    for reports, after in zip(host.played, host.asked[1:], strict=False):
        uploads = np.stack([reports[k].model for k in range(3)]).astype(np.float64)
        assert np.allclose(after.model, uploads.mean(axis=0), rtol=0, atol=1e-7)
        assert all(each.ap is None for each in after.rooms)
    assert [task.number for task in host.asked] == [1, 2, 3, 4]
    own = host.played[-1]
    assert told["digest"]["ap"] == digest(np.concatenate([own[k].ap.ravel() for k in range(3)]))


def test_access_points_may_share_a_network_too(build: Any, plain: tuple[Summary, Any]) -> None:
    told, host = build("run", {"rooms.access_points": "mean"})
    for reports, after in zip(host.played, host.asked[1:], strict=False):
        mean = np.mean([reports[k].ap.astype(np.float64) for k in range(3)], axis=0)
        for each in after.rooms:
            assert np.allclose(each.ap, mean, rtol=0, atol=1e-7)
    assert told["digest"]["ap"] != plain[0]["digest"]["ap"]


def test_all_rooms_start_alike(build: Any) -> None:
    _, host = build("run", {"rooms.robots": [2, 3], "env.state.others": 0, "train.max_ticks": 10})
    [task] = host.asked
    config = host.config
    own = [each.room.config(config) for each in task.rooms]
    initial = robot_network(own[0]).initial_pair(stream(config.seed, Stream.WEIGHTS))
    assert np.array_equal(task.model, initial)
    assert np.array_equal(task.rooms[0].ap, task.rooms[2].ap)
    assert [each.ap.shape[1] for each in task.rooms] == [
        ap_network(each).parameters for each in own
    ]
    assert task.rooms[0].ap.shape != task.rooms[1].ap.shape


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, lambda moved: np.mean(moved)),
        ({"rooms.strategy.name": "fedmedian"}, np.median),
        ({"rooms.strategy.name": "fedavgm", "rooms.strategy.server_rate": 0.5},
         lambda moved: 0.5 * np.mean(moved)),
    ],
)  # fmt: skip
def test_a_strategy_across_rooms_is_applied_to_what_came(
    build: Any, changes: dict[str, Any], expected: Callable[[Any], float]
) -> None:
    """Rooms move every weight by a number of their own, of which the largest is far off."""
    steps = np.array([0.01, 0.02, 0.3], np.float32)

    def moved(index: int, model: Any, ap: Any) -> tuple[Any, Any]:
        return model + steps[index], ap + steps[index]

    _, host = build("run", {**changes, "train.max_ticks": 30}, host=StandIns(moved))
    models = [task.model for task in host.asked]
    assert len(models) == 3
    for one, other in pairwise(models):
        assert np.allclose((other - one)[0], expected(steps), atol=1e-6)


def test_a_room_whose_weights_are_absurd_ends_the_run(build: Any) -> None:
    def absurd(index: int, model: Any, ap: Any) -> tuple[Any, Any]:
        return model * np.float32(np.nan if index == 1 else 1), ap

    with pytest.raises(ValueError, match="absurd weights from room 1"):
        build("run", host=StandIns(absurd))


def test_with_one_strategy_within_and_another_across_both_are_applied(
    build: Any, plain: tuple[Summary, Any]
) -> None:
    runs = [
        plain,
        build("across", {"rooms.strategy.name": "fedmedian"}),
        build("within", {"strategy.name": "fedprox", "strategy.proximal_mu": 0.1}),
    ]
    assert len({told["digest"]["robots"] for told, _ in runs}) == 3


# --- Who takes part -------------------------------------------------------------------------------


def test_a_fraction_of_the_rooms_takes_part_drawn_anew_in_each_round(build: Any) -> None:
    changes = {"rooms.fraction": 0.5, "rooms.count": 4, "train.max_ticks": 60, "seed": 3}
    told, host = build("run", changes)
    took_part = [tuple(sorted(reports)) for reports in host.played]
    assert {len(rooms) for rooms in took_part} == {2}
    assert len({*took_part}) > 2
    for index in range(4):
        assert told["rooms"]["ticks"][index] == 10 * sum(index in rooms for rooms in took_part)
    again = build("again", changes, host=StandIns(lambda index, model, ap: (model, ap)))[1]
    asked = [tuple(each.room.index for each in task.rooms) for task in again.asked]
    assert asked == took_part


def test_a_room_is_told_which_round_it_goes_on_from(build: Any) -> None:
    _, host = build("run", {"train.max_ticks": 50}, {2: (1,), 3: (1, 2)})
    since = {index: [task.rooms[index].since for task in host.asked] for index in range(3)}
    assert since == {0: [0, 1, 2, 3, 4], 1: [0, 1, 1, 1, 4], 2: [0, 1, 2, 2, 4]}
    assert [sorted(task.played) for task in host.asked] == [[], *[[0, 1, 2]] * 4]


def test_rooms_that_missed_rounds_catch_up_on_the_average_of_the_others(build: Any) -> None:
    told, host = build("run", {}, {2: (0, 1), 3: (0,)})
    assert told["rooms"]["ticks"] == [20, 30, 40]
    assert np.allclose(host.asked[2].model, host.played[1][2].model, atol=1e-7)
    pair = [host.played[2][index].model.astype(np.float64) for index in (1, 2)]
    assert np.allclose(host.asked[3].model, np.mean(pair, axis=0), atol=1e-7)
    assert host.played[3][0].ticks == 20


def test_a_round_that_all_rooms_miss_changes_no_weight(build: Any) -> None:
    told, host = build("run", {"rooms.access_points": "mean"}, {1: (0, 1, 2), 3: (0, 1, 2)})
    assert told["rooms"]["ticks"] == [20] * 3
    assert np.array_equal(host.asked[0].model, host.asked[1].model)
    assert np.array_equal(host.asked[2].model, host.asked[3].model)
    assert not np.array_equal(host.asked[1].model, host.asked[2].model)
    assert all(each.ap is not None for each in host.asked[1].rooms)
    assert (told["ticks"], told["windows"]) == (40, 8)


def test_rooms_that_miss_all_rounds_have_the_first_access_point(one_missing: Any) -> None:
    folder, told, host = one_missing
    place = RunFolder(folder).room("0001")
    _, ap = place.read_networks(place.read_config())
    assert np.array_equal(ap, host.asked[0].rooms[1].ap)
    assert told["rooms"]["episodes"][1] == 0


def test_the_rooms_that_were_missing_are_told(one_missing: Any) -> None:
    status = json.loads((one_missing[0] / "progress.json").read_text())
    assert status["rooms"] == {"count": 3, "took_part": 2, "missing": [1]}


def test_no_order_of_reports_changes_a_bit(build: Any, tmp_path: Path) -> None:
    changes = {"rooms.access_points": "mean", "train.max_ticks": 20}
    digests = [build(str(b), changes, backwards=b)[0]["digest"] for b in (False, True)]
    assert digests[0] == digests[1]
    assert records(tmp_path / "False") == records(tmp_path / "True")


def test_nobody_trains_in_rooms_that_are_held_out(build: Any, plain: tuple[Summary, Any]) -> None:
    told, host = build("held_out", {"rooms.held_out": 2})
    assert told["digest"] == plain[0]["digest"]
    asked = {each.room.name for task in host.asked for each in task.rooms}
    assert asked == {"0000", "0001", "0002"}
    assert "held_out" in told["rooms"]
    assert "held_out" not in plain[0]["rooms"]


def test_an_evaluation_plays_in_so_many_rooms_and_the_last_one_in_all(
    build: Any, tmp_path: Path
) -> None:
    changes = {"rooms.evaluated": 2, "rooms.held_out": 3, "evaluation.every": 3}
    build("run", {**changes, "train.max_ticks": 20})
    names = [
        f"{row['held_out']}{row['room']}" for row in rows_of(tmp_path / "run" / "rooms.csv")[::2]
    ]
    assert names[:-6] == ["00", "02", "10", "12"] * (len(names) // 4 - 1)
    assert names[-6:] == ["00", "01", "02", "10", "11", "12"]


# --- Runs that go on ------------------------------------------------------------------------------

VARIANTS: list[dict[str, Any]] = [
    {"state.every": 2},
    {"state.every": 100},
    {"rooms.fraction": 0.5, "rooms.access_points": "mean", "seed": 2, "state.every": 2},
    {
        "rooms.strategy.name": "fedavgm",
        "rooms.strategy.momentum": 0.9,
        "rooms.access_points": "mean",
        "state.every": 3,
    },
]


@pytest.mark.parametrize(
    "changes",
    [*VARIANTS[2:], *(pytest.param(each, marks=pytest.mark.slow) for each in VARIANTS[:2])],
)
def test_a_building_that_is_stopped_goes_on_to_the_same_bits(
    build: Any, resume: Any, tmp_path: Path, changes: dict[str, Any]
) -> None:
    lost = {2: (1,), 4: (0,), 5: (0, 2)}
    whole, _ = build("whole", {**GOES_ON, **changes}, lost)
    stop = RunFolder(tmp_path / "stopped").stop_file

    class Stopped(LossyRooms):
        def play(self, task: Any) -> Any:
            if task.number == 3:
                stop.touch()
            return super().play(task)

    changes = {**GOES_ON, **changes}
    state = RunFolder(tmp_path / "stopped").state
    config = RunFolder(tmp_path / "whole").read_config()
    told, _ = build("stopped", changes, host=Stopped(config, state, lost))
    assert told["stopped_early"]
    assert told["ticks"] == 30
    gone_on = resume("stopped", lost)
    assert not gone_on["stopped_early"]
    assert gone_on["digest"] == whole["digest"] != told["digest"]
    assert gone_on["rooms"]["ticks"] == whole["rooms"]["ticks"]
    assert records(tmp_path / "stopped") == records(tmp_path / "whole")


def test_a_building_that_dies_goes_on_from_its_last_checkpoint(
    build: Any, resume: Any, tmp_path: Path, whole_building: Any
) -> None:
    folder, whole = whole_building
    config, state = RunFolder(folder).read_config(), tmp_path / "died" / "state"

    class Dying(LossyRooms):
        def play(self, task: Any) -> Any:
            if task.number == 5:
                raise OSError("the machine is gone")
            return super().play(task)

    with pytest.raises(OSError, match="gone"):
        build("died", {**GOES_ON, "state.every": 4}, host=Dying(config, state, {}))
    assert checkpoints(server_folder(state)) == [4, 8]
    assert checkpoints(room_folder(state, "0001")) == [2, 4]
    assert resume("died")["digest"] == whole["digest"]
    assert records(tmp_path / "died") == records(folder)


def test_a_building_that_has_ended_can_be_made_longer(
    build: Any, resume: Any, whole_building: Any
) -> None:
    build("short", {**GOES_ON, "state.every": 100, "train.max_ticks": 30})
    assert resume("short", max_ticks=50)["digest"] == whole_building[1]["digest"]


def test_a_building_ends_after_as_many_episodes_a_room(build: Any) -> None:
    told, host = build("run", {"train.episodes": 2, "train.max_ticks": None})
    assert told["episodes"] >= 2
    assert len(host.asked) < 6


def test_the_command_goes_on_with_a_building(
    building_overrides: tuple[str, ...], building_run: Path, tmp_path: Path, capsys: Any
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(building_run, copy)
    assert main(["train", f"resume={copy}"]) == 2
    assert "the run has ended, with" in capsys.readouterr().err
    assert main(["train", f"resume={copy}", "train.max_ticks=50"]) == 0
    assert summary(copy)["ticks"] == 50
    shutil.rmtree(copy / "state" / "rooms" / "0001")
    capsys.readouterr()
    assert main(["train", f"resume={copy}", "train.max_ticks=60"]) != 0
    said = capsys.readouterr().err
    assert "there is no checkpoint" in said
    assert "Traceback" not in said


def test_a_damaged_checkpoint_of_a_room_is_passed_over(
    build: Any, resume: Any, tmp_path: Path, capsys: Any
) -> None:
    build("whole", {"evaluation.every": 2, "state.every": 2, "train.max_ticks": 20})
    whole, damaged = tmp_path / "whole", tmp_path / "damaged"
    shutil.copytree(whole, damaged)
    newest = sorted(room_folder(damaged / "state", "0001").iterdir())[-1]
    newest.write_bytes(newest.read_bytes()[:-5])
    assert main(["train", f"resume={damaged}", "train.max_ticks=40"]) == 0
    assert newest.name in capsys.readouterr().out
    assert resume("whole", max_ticks=40)["digest"] == summary(damaged)["digest"]
    assert records(whole) == records(damaged)


def test_records_that_are_shorter_than_the_checkpoint_says_are_found(
    build: Any, tmp_path: Path, capsys: Any
) -> None:
    build("run", {"evaluation.every": 2, "state.every": 4})
    path = tmp_path / "run" / "rooms.csv"
    path.write_text(path.read_text().splitlines(keepends=True)[0])
    assert main(["train", f"resume={tmp_path / 'run'}", "train.max_ticks=50"]) == 2
    assert "rooms.csv has 0 rows where the checkpoint has " in capsys.readouterr().err


def test_the_local_runtime_keeps_nothing_where_nothing_is_to_be_kept(
    tiny_building: Building, tmp_path: Path
) -> None:
    folder = RunFolder(tmp_path / "run")
    changes = {**QUIET, "run.dir": str(folder.path), "state.every": None, "train.max_ticks": 10}
    local.train(tiny_building(changes), folder)
    assert not folder.state.exists()


# --- The file of the rooms ------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["[", "5", "[5]", "[]"])
def test_a_damaged_file_of_rooms_is_named(
    tiny_building: Building, tmp_path: Path, text: str
) -> None:
    folder = RunFolder(tmp_path)
    folder.rooms_file.write_text(text)
    with pytest.raises(ConfigError, match=r"rooms\.json"):
        known_rooms(tiny_building(), folder)


def test_rooms_of_another_building_are_not_taken(tiny_building: Building, tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    known_rooms(tiny_building(), folder)
    assert len(known_rooms(tiny_building(), folder)) == 4
    for changes in ({"rooms.count": 4}, {"rooms.held_out": 0}):
        with pytest.raises(ConfigError, match="are not those of the run's configuration"):
            known_rooms(tiny_building(changes), folder)


def test_a_checkpoint_error_is_not_hidden(build: Any, resume: Any, tmp_path: Path) -> None:
    build("run", {"train.max_ticks": 20, "state.every": 4})
    for path in room_folder(tmp_path / "run" / "state", "0002").iterdir():
        path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(CheckpointError, match="0002"):
        resume("run", max_ticks=40)
