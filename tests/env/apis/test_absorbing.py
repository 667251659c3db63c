"""Robots that have arrived stay among the agents: masked, paid nothing, of no effect."""

from __future__ import annotations

from typing import Any

import numpy as np
import pettingzoo  # type: ignore[import-untyped]
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

import env
from env.apis.fleet_infos import AP
from env.apis.parallel_env import RISFleetParallelEnv

CONFIG = {"robots": 3, "motion": {"max_slots": 7}, "tasks": {"start_distance_m": 1.0}}
EAST = 12
"""A cell east at the highest power."""


def made(**kwargs: Any) -> RISFleetParallelEnv:
    view = pettingzoo.make("parallel", env.FLEET, config=CONFIG, **kwargs)
    assert isinstance(view, RISFleetParallelEnv)
    return view


def west_of_their_goals(view: RISFleetParallelEnv, *cells: int) -> dict[str, Any]:
    """Options of a reset: starts so many cells west of each destination."""
    goals = view.world.floor.centres()[view.world.destinations]
    return {"starts_m": (goals - [[0.5 * n, 0.0] for n in cells]).tolist()}


def east(view: RISFleetParallelEnv) -> dict[str, int]:
    return {name: 0 if name == AP else EAST for name in view.agents}


def test_it_keeps_pettingzoos_rules() -> None:
    parallel_api_test(made(absorbing=True), num_cycles=100)
    parallel_seed_test(lambda: made(absorbing=True), num_cycles=20)


def test_all_agents_stay_to_the_end_of_all() -> None:
    view = made(absorbing=True)
    view.reset(options=west_of_their_goals(view, 1, 3, 2))
    for left in (3, 2, 1):
        assert view.agents == view.possible_agents
        seen, paid, ended, late, infos = view.step(east(view))
        assert set(seen) == set(paid) == set(infos) == set(view.possible_agents)
        assert set(ended.values()) == {left == 1}
        assert set(late.values()) == {False}
    assert view.agents == []


def test_time_runs_out_for_the_arrived_too() -> None:
    view = made(absorbing=True)
    view.reset(options=west_of_their_goals(view, 1, 8, 8))
    for slot in range(1, 8):
        *_, ended, late, _ = view.step(east(view))
        assert (set(ended.values()), set(late.values())) == ({False}, {slot == 7})


def test_a_robot_that_has_arrived_is_masked_and_paid_nothing_whatever_it_does() -> None:
    random = np.random.default_rng(0)
    view, leaving = made(absorbing=True), made()
    options = west_of_their_goals(view, 1, 4, 6)
    (first, infos), (expected, _) = view.reset(options=options), leaving.reset(options=options)
    np.testing.assert_equal(first, expected)
    assert all(infos[name]["driving"] for name in view.robots)
    for slot in range(1, 7):
        actions = east(view)
        for name in set(view.agents) - set(leaving.agents):
            actions[name] = int(random.integers(24))
        seen, paid, _, _, infos = view.step(actions)
        expected, due, ended, _, told = leaving.step(east(leaving))
        for name, reward in paid.items():
            assert reward == due.get(name, 0.0)
            if name in expected:
                np.testing.assert_array_equal(seen[name], expected[name])
                assert {key: infos[name][key] for key in told[name]} == told[name]
            if name != AP:
                arrived = slot >= {"robot_0": 1, "robot_1": 4, "robot_2": 6}[name]
                assert infos[name]["driving"] is not arrived
                assert infos[name]["action_mask"].sum() == (1 if arrived else 24)
                assert seen[name][3:].any() != arrived
        assert infos[AP]["action_mask"].tolist() == [1] * 4
        assert ended[AP] == (slot == 6)


def test_a_robot_that_drives_still_needs_its_action() -> None:
    view = made(absorbing=True)
    view.reset(options=west_of_their_goals(view, 1, 3, 3))
    view.step(east(view))
    with pytest.raises(ValueError, match="action of robot_1=None: allowed is a whole number"):
        view.step({AP: 0})
    view.step(dict.fromkeys(view.robots[1:], EAST) | {AP: 0})


def test_the_registry_knows_the_fleet_and_its_arguments() -> None:
    assert pettingzoo.spec("parallel", env.FLEET).entry_point.endswith("RISFleetParallelEnv")
    assert made().absorbing is False
    with pytest.raises(ValueError, match=r"env\.robots=0: allowed is a number from 1 to 64"):
        pettingzoo.make("parallel", env.FLEET, config={"robots": 0})
