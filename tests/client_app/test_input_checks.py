"""What a robot does not believe: it says so, names the value, and has learned nothing from it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.networks.limits import WEIGHT_LIMIT
from client_app.input_checks import CHANNEL_LIMIT_DB, FEW, RATE_LIMIT, check_received
from client_app.robots import RobotGroup
from conf import Config, robot_network
from env.mdp import reward
from env.seeding import Stream, stream
from lockstep import UPDATE, Expect, Flag, Step
from training.partition import step_layout

CELLS = 48
ROBOTS = (3, 1)
LEARNING = int(Flag.OUTCOME | Flag.DRIVING)


def received(tick: int = 1, **changes: Any) -> Step:
    """A step in which the second robot's record is changed."""
    updates = np.zeros(2, UPDATE)
    updates["flags"], updates["rate"] = LEARNING, 3.0
    updates["channel_db"] = updates["outcome_channel_db"] = -70.0
    for name, value in changes.items():
        updates[name][1] = value
    return Step(tick, 1, Expect.ACTIONS, updates)


@pytest.fixture
def group(tiny: Callable[..., Config]) -> RobotGroup:
    """Two robots that learn from their first transition on."""
    config = tiny({"agent.learn_from": 1, "agent.batch_size": 1, "env.robots": 4})
    initial = robot_network(config).initial_pair(stream(0, Stream.WEIGHTS))
    robots = RobotGroup(config, ROBOTS)
    robots.download(0, initial)
    return robots


@pytest.mark.parametrize(
    ("change", "shown"),
    [
        ({"rate": np.nan}, "rate=nan"),
        ({"rate": np.inf}, "rate=inf"),
        ({"rate": -0.001}, "rate=-0.001"),
        ({"rate": 1.001 * RATE_LIMIT}, "rate=1025.02"),
        ({"cell": CELLS}, "cell=48"),
        ({"cell": -1}, "cell=-1"),
        ({"outcome_cell": 2**31 - 1}, r"outcome_cell=2\.14748e\+09"),
        ({"outcome_cell": -CELLS}, "outcome_cell=-48"),
        ({"channel_db": np.nan}, "channel_db=nan"),
        ({"channel_db": np.float32(1e30)}, r"channel_db=1e\+30"),
        ({"outcome_channel_db": -np.inf}, "outcome_channel_db=-inf"),
    ],
)
def test_what_cannot_be_is_named_and_nothing_is_learned_from_it(
    group: RobotGroup, change: dict[str, Any], shown: str
) -> None:
    group.step(received(0))
    before = group.upload()
    with pytest.raises(ValueError, match=rf"tick 7: robot 1 received what cannot be .*{shown}[,)]"):
        group.step(received(7, **change))
    np.testing.assert_array_equal(group.upload(), before)
    group.step(received(7))
    assert (group.upload() != before).any()


def test_what_is_extreme_but_possible_is_believed(group: RobotGroup) -> None:
    for change in (
        {"rate": 0.0},
        {"rate": RATE_LIMIT},
        {"cell": CELLS - 1, "outcome_cell": 0},
        {"channel_db": -CHANNEL_LIMIT_DB, "outcome_channel_db": CHANNEL_LIMIT_DB},
    ):
        assert group.step(received(**change)) is not None


def test_no_float64_makes_a_rate_or_a_channel_beyond_the_limits() -> None:
    info = np.finfo(np.float64)
    assert np.log2(info.max) <= RATE_LIMIT
    assert (
        10 * abs(np.log10(np.array([info.max, info.smallest_subnormal]))).max() < CHANNEL_LIMIT_DB
    )


def test_a_reward_that_is_not_finite_is_named(
    group: RobotGroup, monkeypatch: pytest.MonkeyPatch
) -> None:
    group.step(received(0))
    before = group.upload()

    def broken(rate: NDArray[np.float64], *rest: Any) -> NDArray[np.float64]:
        return np.where(np.arange(len(rate)) == 0, np.inf, reward.local_reward(rate, *rest))

    monkeypatch.setattr(group._slice._rewards, "_local", broken)
    with pytest.raises(ValueError, match="tick 5: the reward of robot 3 is inf"):
        group.step(received(5))
    np.testing.assert_array_equal(group.upload(), before)


def test_only_a_reward_that_is_learned_from_counts(
    group: RobotGroup, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(group._slice._rewards, "_local", lambda rate, *_: np.array([0.5, np.nan]))
    assert group.step(received(1, flags=0)) is not None


# --- Robots in many worlds ------------------------------------------------------------------------

MANY = {
    "agent.learn_from": 1,
    "agent.batch_size": 1,
    "env.robots": 4,
    "env.reward.credit": "difference",
    "env.state.others": 1,
    "env.state.way": "on",
}


def received_in_worlds(config: Config, tick: int, row: int = 0, **changes: Any) -> Step:
    """A step for two robots in which one record is changed."""
    layout = step_layout(config)
    updates = np.zeros(2 * layout.worlds, layout.record)
    updates["flags"], updates["rate"], updates["credit"] = LEARNING, 3.0, 2.0
    updates["channel_db"] = updates["outcome_channel_db"] = -70.0
    for name, value in changes.items():
        updates[name][row] = value
    return Step(tick, 1, Expect.ACTIONS, updates)


@pytest.mark.parametrize("worlds", [3, 20])
@pytest.mark.parametrize(
    ("change", "shown"),
    [
        ({"rate": np.nan}, r"robot {} received what cannot be .*rate=nan[,)]"),
        ({"rate": 2 * RATE_LIMIT}, r"robot {} received what cannot be .*rate=2048[,)]"),
        ({"cell": CELLS}, r"robot {} received what cannot be .*cell=48[,)]"),
        ({"outcome_cell": -1}, r"robot {} received what cannot be .*outcome_cell=-1[,)]"),
        ({"channel_db": np.inf}, r"robot {} received what cannot be .*channel_db=inf[,)]"),
        ({"outcome_channel_db": np.nan}, r"robot {} received what cannot be .*channel_db=nan[,)]"),
        ({"broadcast": np.nan}, "a broadcast to robot {} is nan"),
        ({"outcome_broadcast": np.inf}, "a broadcast to robot {} is inf"),
        ({"credit": -np.inf}, "the reward of robot {} is -inf"),
        ({"credit": np.nan}, "the reward of robot {} is nan"),
    ],
)
def test_one_bad_record_of_many_is_named_by_its_robot_and_not_learned_from(
    tiny: Callable[..., Config], worlds: int, change: dict[str, Any], shown: str
) -> None:
    config = tiny({**MANY, "train.worlds": worlds})
    assert (2 * worlds > FEW) == (worlds == 20)
    initial = robot_network(config).initial_pair(stream(0, Stream.WEIGHTS))
    group = RobotGroup(config, ROBOTS)
    group.download(0, initial)
    group.step(received_in_worlds(config, 0))
    before = group.upload()
    for row, robot in ((worlds - 1, 3), (worlds, 1), (2 * worlds - 2, 1)):
        with pytest.raises(ValueError, match="tick 7: " + shown.format(robot)):
            group.step(received_in_worlds(config, 7, row, **change))
    np.testing.assert_array_equal(group.upload(), before)
    assert group.step(received_in_worlds(config, 8)).shape == (2 * worlds,)
    assert (group.upload() != before).any(axis=(1, 2)).all()


@pytest.mark.parametrize(
    ("bad", "shown"), [(np.nan, "nan"), (-np.inf, "inf"), (2 * WEIGHT_LIMIT, r"2e\+04")]
)
def test_an_absurd_model_is_named_and_not_taken(group: RobotGroup, bad: float, shown: str) -> None:
    before = group.upload()
    model = before[0].copy()
    model[1, 7] = bad
    with pytest.raises(ValueError, match=rf"window 9: the global model .* \({shown}\)"):
        group.download(9, model)
    np.testing.assert_array_equal(group.upload(), before)


def test_each_robot_needs_a_record() -> None:
    with pytest.raises(ValueError, match="shorter"):
        check_received(0, (0, 1, 2), received().updates, CELLS)
