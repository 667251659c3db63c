"""Vectorised by Gymnasium, the single-robot view stays what it is alone, over a grid of worlds."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test, parallel_seed_test
from small_floor import SMALL, on_small_floor

import env
from env.apis.parallel_env import parallel_env

WORLDS = 3
SLOTS = 6
GRID: dict[str, dict[str, Any]] = {
    "noma": {"access": "noma"},
    "oma": {"access": "oma"},
    "oma_reallocated": {"access": "oma", "oma": {"share": "reallocate"}},
    "qoe": {"metric": "qoe"},
    "oma_qoe": {"access": "oma", "metric": "qoe"},
    "coherent": {"ris": {"response": "coherent"}},
    "far": {"ris": {"response": "far", "side": 8}},
    "near": {"ris": {"response": "near", "side": 8}},
    "rayleigh": {"ris": {"response": "rayleigh", "side": 8}},
    "without_ris": {"ris": {"side": 0}},
    "two_subsurfaces": {"ris": {"subsurfaces": 2}},
    "one_robot": {"robots": 1},
    "eight_robots_residual": {"robots": 8, "power": {"resolve": "residual"}},
    "no_destination": {"state": {"destination": "none"}},
    "fading_each_slot": {"channel": {"fading": "slot"}},
    "random_tasks": {"tasks": {"destination": "random"}},
    "common_task": {"tasks": {"destination": "common"}},
    "codebook": {"ris": {"response": "near", "side": 4, "action": "codebook", "sectors": [2, 2]}},
    "corridor": {"plan": "corridor"},
    "all_that_serves_the_objective": {
        "robots": 4,
        "state": {"way": "on", "others": 3, "weights": True, "order": "gain"},
        "reward": {"credit": "difference", "weights": "objective", "guidance_discount": 0.8},
    },
    "solid_walls_without_collisions": {
        "robots": 4,
        "collisions": "block",
        "walls": {"block_motion": True},
    },
    "as_many_robots_as_there_may_be": {"robots": 64, "access": "oma"},
}
each_world = pytest.mark.parametrize("config", GRID.values(), ids=GRID)


def short(config: dict[str, Any]) -> dict[str, Any]:
    """The same on a small floor, in episodes of a few slots with starts that are near enough."""
    config = on_small_floor(config)
    tasks = {**config.get("tasks", {}), "start_distance_m": 1.0}
    return {**config, "motion": {"max_slots": SLOTS}, "tasks": tasks}


@pytest.fixture(autouse=True)
def _warnings_are_errors() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def vectorised(config: dict[str, Any], mode: str = "sync") -> gymnasium.vector.VectorEnv:
    return gymnasium.make_vec(
        env.SINGLE_ROBOT, num_envs=WORLDS, vectorization_mode=mode, config=short(config)
    )


def agrees_with_single_envs(config: dict[str, Any], mode: str) -> None:
    """Through two ends of time and the resets after them; arrivals are tested by themselves."""
    many = vectorised(config, mode)
    alone = [gymnasium.make(env.SINGLE_ROBOT, config=short(config)) for _ in range(WORLDS)]
    random = np.random.default_rng(3)
    seen, infos = many.reset(seed=11)
    for i, single in enumerate(alone):
        first, info = single.reset(seed=11 + i)
        np.testing.assert_array_equal(seen[i], first)
        assert infos["shortest_slots"][i] == info["shortest_slots"]
    over = np.zeros(WORLDS, dtype=bool)
    for _ in range(2 * SLOTS + 3):
        picks = random.integers(many.single_action_space.n, size=WORLDS)  # type: ignore[attr-defined]
        seen, paid, ended, out, _ = many.step(picks)
        assert many.observation_space.contains(seen)
        for i, single in enumerate(alone):
            if over[i]:  # this step of the many was the reset, and paid nothing
                expected = (single.reset()[0], 0.0, False, False)
            else:
                expected = single.step(picks[i])[:4]
            np.testing.assert_array_equal(seen[i], expected[0])
            assert (paid[i], ended[i], out[i]) == expected[1:]
        over = ended | out
    many.close()


@each_world
def test_the_views_keep_the_libraries_rules(config: dict[str, Any]) -> None:
    config = short(config)
    check_env(gymnasium.make(env.SINGLE_ROBOT, config=config).unwrapped, skip_render_check=True)
    parallel_api_test(parallel_env(config=config), num_cycles=3 * SLOTS)
    parallel_seed_test(lambda: parallel_env(config=config), num_cycles=SLOTS)


@each_world
def test_a_pickled_fleet_goes_on_alike_and_draws_the_same(config: dict[str, Any]) -> None:
    drawn = "plan" in config or "metric" in config  # pictures are slow
    view = parallel_env(config=short(config), render_mode="rgb_array" if drawn else "ansi")
    view.reset(seed=1)
    twin = pickle.loads(pickle.dumps(view))
    moves = {agent: view.action_space(agent).sample() for agent in view.agents}
    first, second = view.step(moves), twin.step(moves)
    assert first[1:] == second[1:]
    np.testing.assert_array_equal(view.render(), twin.render())


@each_world
def test_many_have_the_spaces_of_one(config: dict[str, Any]) -> None:
    many = vectorised(config)
    one = gymnasium.make(env.SINGLE_ROBOT, config=short(config))
    assert many.num_envs == WORLDS
    assert many.single_observation_space == one.observation_space
    assert many.single_action_space == one.action_space
    assert many.observation_space.shape == (WORLDS, *one.observation_space.shape)
    assert many.observation_space.dtype == np.float32
    many.close()


@each_world
def test_many_step_as_each_alone_with_its_seed_and_reset_themselves(config: dict[str, Any]) -> None:
    agrees_with_single_envs(config, "sync")


def test_many_in_processes_of_their_own_step_as_each_alone() -> None:
    agrees_with_single_envs({"robots": 2}, "async")


def test_one_that_arrives_begins_again_and_the_others_go_on() -> None:
    many = vectorised({"robots": 1, "tasks": {"start_distance_m": 0.5}})
    assert isinstance(many, gymnasium.vector.SyncVectorEnv)
    goal = SMALL["tasks"]["destinations_m"][0]
    levels = env.EnvConfig().power.levels
    many.reset(seed=0)
    near = {"starts_m": [[goal[0] - 0.5, goal[1]]]}
    many.envs[1].reset(seed=1, options=near)
    _, paid, ended, out, infos = many.step(np.full(WORLDS, 2 * levels))  # east
    assert ended.tolist() == [False, True, False]
    assert not out.any()
    assert paid[1] > 90
    assert infos["arrived"].tolist() == [False, True, False]
    seen, paid, ended, _, infos = many.step(np.full(WORLDS, 2 * levels))
    assert not ended[1]
    assert paid[1] == 0.0
    assert infos["shortest_slots"][1] > 0
    assert np.abs(seen[1, 3:]).max() > 0
    many.close()
