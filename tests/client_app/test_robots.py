"""A client's robots: what they do when they are told something, and what they keep."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from flwr.app import ConfigRecord
from numpy.typing import NDArray

from agent.replay import RowLayout
from client_app.app import RoundConfig
from client_app.robots import RobotGroup
from client_app.state import load_state, save_state
from conf import Config, robot_network, to_yaml
from env.seeding import Stream, stream
from lockstep import UPDATE, Expect, Flag, Step
from storage.checkpoint_files import CheckpointError, checkpoints
from storage.checkpoint_layout import robot_folder
from training.partition import step_layout

Tiny = Callable[..., Config]


def received(tick: int, expect: Expect, flags: Sequence[int], window: int = 1) -> Step:
    """A step with cells and channels that depend on the tick."""
    updates = np.zeros(len(flags), dtype=UPDATE)
    rng = np.random.default_rng(tick)
    updates["flags"] = flags
    for name in ("cell", "outcome_cell"):
        updates[name] = rng.integers(48, size=len(flags))
    for name in ("channel_db", "outcome_channel_db"):
        updates[name] = rng.normal(-70, 10, size=len(flags))
    updates["rate"] = rng.uniform(0, 20, size=len(flags))
    return Step(tick, window, expect, updates)


def drive(group: RobotGroup, ticks: range, window: int = 1) -> list[NDArray[np.int32]]:
    """Lets all robots drive and learn; returns their actions."""
    count = len(group.robots)
    if ticks.start == 0:
        first = group.step(received(0, Expect.ACTIONS, [Flag.DRIVING] * count, window))
        assert first is not None
    answers = []
    for tick in ticks:
        flags = [int(Flag.OUTCOME | Flag.DRIVING)] * count
        answer = group.step(received(tick + 1, Expect.ACTIONS, flags, window))
        assert answer is not None
        answers.append(answer)
    return answers


@pytest.fixture
def initial(tiny: Tiny) -> NDArray[np.float32]:
    return robot_network(tiny()).initial_pair(stream(0, Stream.WEIGHTS))


@pytest.fixture
def make_group(tiny: Tiny, initial: NDArray[np.float32]) -> Callable[..., RobotGroup]:
    def make(robots: Sequence[int] = (0, 1, 2), **changes: float) -> RobotGroup:
        group = RobotGroup(tiny({f"strategy.{key}": x for key, x in changes.items()}), robots)
        group.download(0, initial)
        return group

    return make


# --- Steps ----------------------------------------------------------------------------------------


def test_only_robots_that_drive_are_given_actions(make_group: Callable[..., RobotGroup]) -> None:
    chosen = make_group().step(received(0, Expect.ACTIONS, [Flag.DRIVING, 0, Flag.DRIVING]))
    assert chosen is not None
    assert chosen.dtype == np.int32
    assert chosen[1] == -1
    assert 0 <= chosen[0] < 24
    assert 0 <= chosen[2] < 24


@pytest.mark.parametrize("expect", [Expect.WEIGHTS, Expect.END_ROUND])
def test_the_last_step_of_a_window_is_learned_from_and_not_answered(
    make_group: Callable[..., RobotGroup], expect: Expect
) -> None:
    group = make_group()
    drive(group, range(12))
    before = group.upload()
    flags = [int(Flag.OUTCOME | Flag.DRIVING)] * 3
    assert group.step(received(13, expect, flags, window=4)) is None
    assert group.window == 4
    assert (group.upload()[:, 0] != before[:, 0]).any(axis=1).all()


def test_robots_without_an_outcome_learn_nothing(make_group: Callable[..., RobotGroup]) -> None:
    group = make_group()
    drive(group, range(12))
    before = group.upload()
    group.step(received(13, Expect.WEIGHTS, [Flag.DRIVING | Flag.OUTCOME, 0, Flag.DRIVING]))
    changed = (group.upload()[:, 0] != before[:, 0]).any(axis=1)
    assert changed.tolist() == [True, False, False]


def test_a_broadcast_alone_may_tell_the_outcome_from_the_next_start(tiny: Tiny) -> None:
    """A robot that begins anew in the cell that it reached has others around it."""
    config = tiny({"env.state.others": 1, "train.worlds": 2})
    group, layout = RobotGroup(config, (1,)), step_layout(config)
    updates = np.zeros(2, layout.record)
    updates["flags"] = int(Flag.OUTCOME | Flag.DRIVING)
    updates["cell"] = updates["outcome_cell"] = 5
    updates["channel_db"] = updates["outcome_channel_db"] = -70.0
    updates["outcome_broadcast"] = np.arange(2 * layout.broadcast).reshape(2, -1)
    group.step(Step(1, 1, Expect.ACTIONS, updates))
    rows = RowLayout(robot_network(config).inputs).unpack(group.agents.agent_state(0)["replay"])
    heard = rows[3][:, -layout.broadcast :]
    np.testing.assert_array_equal(heard, updates["outcome_broadcast"])


def test_learning_begins_with_enough_transitions(
    make_group: Callable[..., RobotGroup], initial: NDArray[np.float32]
) -> None:
    group = make_group()
    drive(group, range(7))
    assert (group.upload() == initial).all()
    drive(group, range(7, 8))
    assert not (group.upload() == initial).all()


def test_an_upload_is_a_copy_and_a_download_reaches_all(
    make_group: Callable[..., RobotGroup], initial: NDArray[np.float32]
) -> None:
    group = make_group()
    group.upload()[:] = 7
    assert (group.upload() == initial).all()
    group.download(1, initial + 1)
    assert (group.upload() == initial + 1).all()
    assert group.upload().shape == (3, 2, group.parameters)


def test_a_robot_is_the_same_in_any_group(make_group: Callable[..., RobotGroup]) -> None:
    alone, pair = make_group((2,)), make_group((1, 2))
    start = received(0, Expect.ACTIONS, [Flag.DRIVING] * 2)
    alone.step(Step(0, 1, Expect.ACTIONS, start.updates[1:].copy()))
    pair.step(start)
    for tick in range(1, 40):
        step = received(tick, Expect.ACTIONS, [int(Flag.OUTCOME | Flag.DRIVING)] * 2)
        one = alone.step(Step(tick, 1, Expect.ACTIONS, step.updates[1:].copy()))
        two = pair.step(step)
        assert one is not None
        assert two is not None
        assert one[0] == two[1]
    assert alone.upload()[0].tobytes() == pair.upload()[1].tobytes()


def test_the_proximal_term_reaches_the_learner(make_group: Callable[..., RobotGroup]) -> None:
    plain, held = make_group(), make_group(proximal_mu=5.0)
    drive(plain, range(30))
    drive(held, range(30))
    assert plain.upload().tobytes() != held.upload().tobytes()


# --- State ----------------------------------------------------------------------------------------


def test_robots_go_on_from_their_files_to_the_same_bits(
    make_group: Callable[..., RobotGroup], tmp_path: Path
) -> None:
    whole = make_group()
    drive(whole, range(20))
    save_state(whole, tmp_path, 2)
    fresh = make_group()
    load_state(fresh, tmp_path, 2)
    for group in (whole, fresh):
        group.step(received(20, Expect.ACTIONS, [Flag.DRIVING] * 3, window=3))
    one, other = drive(whole, range(21, 45)), drive(fresh, range(21, 45))
    np.testing.assert_array_equal(one, other)
    assert whole.upload().tobytes() == fresh.upload().tobytes()


def test_robots_may_be_dealt_anew_between_rounds(
    make_group: Callable[..., RobotGroup], tmp_path: Path
) -> None:
    whole = make_group()
    drive(whole, range(20))
    save_state(whole, tmp_path, 1)
    moved = make_group((2, 0))
    load_state(moved, tmp_path, 1)
    assert moved.upload().tobytes() == whole.upload()[[2, 0]].tobytes()


def test_each_robot_keeps_its_last_three_checkpoints_in_a_folder_of_its_own(
    make_group: Callable[..., RobotGroup], tmp_path: Path
) -> None:
    group = make_group((0, 2))
    for window in (1, 2, 3, 4):
        save_state(group, tmp_path, window)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["robot-00", "robot-02"]
    assert checkpoints(robot_folder(tmp_path, 2)) == [2, 3, 4]


def test_a_missing_or_damaged_checkpoint_is_an_error_that_names_the_file(
    make_group: Callable[..., RobotGroup], tmp_path: Path
) -> None:
    group = make_group()
    with pytest.raises(CheckpointError, match="robot-00"):
        load_state(group, tmp_path, 1)
    save_state(group, tmp_path, 1)
    (path,) = robot_folder(tmp_path, 1).glob("*.safetensors")
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(CheckpointError, match="robot-01"):
        load_state(group, tmp_path, 1)


# --- Orders ---------------------------------------------------------------------------------------


def test_an_order_is_read_as_it_was_written(tiny: Tiny) -> None:
    config = tiny({"seed": 9, "strategy.name": "fedprox", "strategy.proximal_mu": 0.25})
    record = ConfigRecord(
        {
            "config": to_yaml(config),
            "robots": [1, 2],
            "tokens": ["a", "b"],
            "host": "127.0.0.1",
            "port": 4711,
            "window": 20,
            "round": 3,
            "certificate": "PEM",
        }
    )
    order = RoundConfig.read(record)
    address = ("127.0.0.1", 4711)
    assert order == RoundConfig(config, (1, 2), ["a", "b"], address, 20, 3, "PEM")
