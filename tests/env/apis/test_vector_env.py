"""The batched single-robot environment is Gymnasium's synchronous one, bit for bit."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from small_floor import on_small_floor

import env
from env.apis.single_robot_vector import SingleRobotVectorEnv

NAME = env.SINGLE_ROBOT
SHORT = {"max_slots": 6}
NEAR = {"start_distance_m": 1.0, "destination_spacing_m": 1.0}
CONFIGS: dict[str, dict[str, Any]] = {
    "three_robots": {"motion": SHORT, "tasks": NEAR},
    "without_ris": {"robots": 2, "ris": {"side": 0}, "motion": SHORT, "tasks": NEAR},
    "fading_of_each_slot": {"channel": {"fading": "slot"}, "motion": SHORT, "tasks": NEAR},
    "robots_that_block": {"robots": 4, "collisions": "block", "motion": SHORT, "tasks": NEAR},
    "told_of_others": {
        "state": {"others": 2, "way": "on"},
        "reward": {"credit": "difference", "weights": "objective"},
        "motion": SHORT,
        "tasks": NEAR,
    },
    "oma": {"access": "oma", "motion": SHORT, "tasks": NEAR},
}
CONFIGS = {name: on_small_floor(config) for name, config in CONFIGS.items()}
each_mode = pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.value)


def batched(num_envs: int, **kwargs: Any) -> SingleRobotVectorEnv:
    made = gymnasium.make_vec(
        NAME, num_envs=num_envs, vectorization_mode="vector_entry_point", **kwargs
    )
    assert isinstance(made, SingleRobotVectorEnv)
    return made


def one_by_one(num_envs: int, mode: AutoresetMode, **kwargs: Any) -> SyncVectorEnv:
    made = gymnasium.make_vec(
        NAME,
        num_envs=num_envs,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
        **kwargs,
    )
    assert isinstance(made, SyncVectorEnv)
    return made


def assert_same(ours: Any, theirs: Any) -> None:
    assert data_equivalence(ours, theirs, exact=True)


@each_mode
@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_it_is_the_single_environments_bit_for_bit(
    config: dict[str, Any], mode: AutoresetMode
) -> None:
    ours = batched(5, config=config, autoreset_mode=mode)
    theirs = one_by_one(5, mode, config=config)
    random = np.random.default_rng(3)
    assert_same(ours.reset(seed=7), theirs.reset(seed=7))
    endings = 0
    for _ in range(25):
        actions = random.integers(ours.world.scenario.actions.count, size=5)
        got, expected = ours.step(actions), theirs.step(actions)
        assert_same(got, expected)
        ended = got[2] | got[3]
        endings += ended.sum()
        if mode is AutoresetMode.DISABLED and ended.any():
            assert_same(
                ours.reset(options={"reset_mask": ended}),
                theirs.reset(options={"reset_mask": ended}),
            )
    assert endings > 10


def test_it_is_one_single_environment_when_there_is_one() -> None:
    ours, single = batched(1), gymnasium.make(NAME)
    seen, _ = ours.reset(seed=4)
    expected, _ = single.reset(seed=4)
    np.testing.assert_array_equal(seen[0], expected)
    over = False
    while not over:
        action = single.action_space.sample()
        seen, paid, ended, late, _ = ours.step(np.array([action]))
        expected, reward, *ends, _ = single.step(action)
        np.testing.assert_array_equal(seen[0], expected)
        assert (paid[0], [ended[0], late[0]]) == (reward, ends)
        over = any(ends)


def test_make_vec_takes_it_by_default_and_all_its_spaces_are_batches() -> None:
    ours, theirs = gymnasium.make_vec(NAME, num_envs=4), one_by_one(4, AutoresetMode.NEXT_STEP)
    assert isinstance(ours.unwrapped, SingleRobotVectorEnv)
    for space in ("observation_space", "action_space"):
        for name in (space, f"single_{space}"):
            assert getattr(ours, name) == getattr(theirs, name)
    assert ours.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    seen, _ = ours.reset(seed=0)
    assert ours.observation_space.contains(seen)


def test_a_partial_reset_leaves_the_others_and_their_generators() -> None:
    kwargs = {"config": CONFIGS["fading_of_each_slot"]}
    ours = batched(3, autoreset_mode="Disabled", **kwargs)
    theirs = one_by_one(3, AutoresetMode.DISABLED, **kwargs)
    for made in (ours, theirs):
        made.reset(seed=1)
        made.step(np.zeros(3, dtype=np.int64))
    mask = np.array([False, True, False])
    starts = [[2.0, 2.0], [4.0, 1.0], [6.0, 3.0]]
    got, expected = (
        made.reset(seed=[9, 8, None], options={"reset_mask": mask, "starts_m": starts})
        for made in (ours, theirs)
    )
    assert_same(got, expected)
    assert got[1]["_phase"].tolist() == mask.tolist()
    for made in (ours, theirs):
        made.reset(options={"reset_mask": ~mask})
    assert_same(ours.step(np.ones(3, dtype=np.int64)), theirs.step(np.ones(3, dtype=np.int64)))
    assert ours.np_random_seed == theirs.np_random_seed


def test_what_was_given_out_stays_as_it_was() -> None:
    ours = batched(4, config=CONFIGS["three_robots"], autoreset_mode="SameStep")
    given = [ours.reset(seed=0)]
    copies = [np.array(given[0][0])]
    for _ in range(12):
        given.append(ours.step(np.zeros(4, dtype=np.int64)))
        copies.append(np.array(given[-1][0]))
    for slot, copy in zip(given, copies, strict=True):
        np.testing.assert_array_equal(slot[0], copy)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"num_envs": 0}, "num_envs=0: allowed is a whole number from 1 on"),
        ({"num_envs": True}, "num_envs=True: allowed is a whole number"),
        ({"render_mode": "rgb_array"}, "render_mode='rgb_array': allowed is None"),
        ({"autoreset_mode": "never"}, "autoreset_mode='never': allowed is NextStep, SameStep"),
        ({"others": "all"}, "others='all': allowed is shortest or none"),
        ({"config": {"robots": 0}}, "env.robots=0: allowed is a number from 1 to 64"),
    ],
)
def test_wrong_arguments_are_named(kwargs: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SingleRobotVectorEnv(**kwargs)


def test_wrong_calls_are_named() -> None:
    ours = batched(2, config=CONFIGS["three_robots"], autoreset_mode="Disabled")
    good = np.zeros(2, dtype=np.int64)
    assert len(ours.np_random) == len({*ours.np_random_seed}) == 2
    with pytest.raises(ResetNeeded, match="call reset"):
        ours.step(good)
    with pytest.raises(ResetNeeded, match="takes no reset_mask"):
        ours.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(ValueError, match="seed=\\[1\\]: allowed is a number, or 2 of them"):
        ours.reset(seed=[1])
    ours.reset(seed=0)
    for wrong in ([0, 24], [0], [0.0, 1.0]):
        with pytest.raises(ValueError, match="allowed is 2 whole numbers from 0 to 23"):
            ours.step(np.array(wrong))
    for mask in ([True, False], np.array([1, 0]), np.zeros(2, dtype=bool), np.ones(3, dtype=bool)):
        with pytest.raises(ValueError, match=r"options.reset_mask=.*: allowed is a bool array"):
            ours.reset(options={"reset_mask": mask})
    with pytest.raises(ValueError, match="allowed is the option starts_m"):
        ours.reset(options={"start": 1})
    while not ours.step(good)[3].any():
        pass
    with pytest.raises(ResetNeeded, match="call reset"):
        ours.step(good)
