"""The public views keep the rules of Gymnasium and PettingZoo, and add nothing to the world."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, seed_test
from pettingzoo.utils.conversions import parallel_to_aec
from small_floor import on_small_floor

import env
from env.apis.fleet_infos import AP
from env.apis.parallel_env import RISFleetParallelEnv, parallel_env
from env.apis.single_robot import SingleRobotEnv
from env.config import EnvConfig, RisConfig
from env.mdp.actions import ActionSpace
from env.rendering.drawing import missed, trajectory_figure
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World

SHORT = {"max_slots": 30}
CONFIGS: dict[str, dict[str, Any]] = {
    "three_robots": {"motion": SHORT},
    "one_robot": {"robots": 1, "motion": SHORT},
    "two_robots_without_ris": {"robots": 2, "ris": {"side": 0}, "motion": SHORT},
    "four_robots": {"robots": 4, "motion": SHORT},
    "drawn_destinations": {"robots": 6, "motion": SHORT},
    "state_without_destination": {"robots": 2, "state": {"destination": "none"}, "motion": SHORT},
    "round_solid_walls": {"robots": 2, "walls": {"block_motion": True}, "motion": SHORT},
    "a_plan": {"robots": 2, "plan": "corridor", "motion": {"max_slots": 120}},
    "the_way": {"robots": 2, "state": {"way": "on", "destination": "none"}, "motion": SHORT},
    "weights_by_gain": {
        "robots": 3,
        "state": {"weights": True, "order": "gain"},
        "reward": {"credit": "difference", "weights": "objective", "guidance_discount": 0.8},
        "motion": SHORT,
    },
    "told_of_others": {"robots": 3, "state": {"others": 2, "way": "on"}, "motion": SHORT},
    "told_of_one_other": {
        "robots": 3,
        "state": {"others": 1, "destination": "none"},
        "reward": {"horizon_slots": 200.0},
        "motion": SHORT,
    },
    "residual": {"robots": 4, "power": {"resolve": "residual", "levels": 3}, "motion": SHORT},
    "zero": {"robots": 2, "power": {"resolve": "zero"}, "motion": SHORT},
    "two_subsurfaces": {"robots": 2, "ris": {"subsurfaces": 2}, "motion": SHORT},
    "a_narrow_room": {
        "robots": 1,
        "room": {"width_m": 12.0, "depth_m": 31.0},
        "ap": {"position_m": [6.0, 31.0, 2.0]},
        "ris": {"position_m": [12.0, 7.5, 2.0]},
        "tasks": {"destinations_m": [[4.25, 10.25]]},
        "motion": SHORT,
    },
}
each_config = pytest.mark.parametrize(
    "config", [on_small_floor(config) for config in CONFIGS.values()], ids=CONFIGS
)


@pytest.fixture(autouse=True)
def _warnings_are_errors() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def sampled(view: RISFleetParallelEnv) -> dict[str, Any]:
    return {agent: view.action_space(agent).sample() for agent in view.agents}


def beside(view: RISFleetParallelEnv, cells: int) -> list[list[float]]:
    """Starts that many cells west of each destination, in m."""
    goals = view.world.floor.centres()[view.world.destinations]
    return (goals - [cells * view.config.room.cell_m, 0.0]).tolist()


def single(**kwargs: Any) -> SingleRobotEnv:
    made = gymnasium.make("risfleet/SingleRobot-v0", **kwargs).unwrapped
    assert isinstance(made, SingleRobotEnv)
    return made


EAST = int(ActionSpace(6).encode(np.array(2), np.array(1)))


@each_config
def test_the_parallel_view_keeps_pettingzoos_rules(config: dict[str, Any]) -> None:
    parallel_api_test(parallel_env(config=config), num_cycles=80)
    parallel_seed_test(lambda: parallel_env(config=config), num_cycles=20)


def test_the_parallel_view_converts_to_turns() -> None:
    config = {"robots": 2, "motion": SHORT}
    with warnings.catch_warnings():
        # Advice that this fleet does not take: the access point sees more, and has no number.
        for advice in (".* different (shapes|observation space sizes)", "We recommend agents"):
            warnings.filterwarnings("ignore", message=advice)
        api_test(parallel_to_aec(parallel_env(config=config)), num_cycles=50)
    seed_test(lambda: parallel_to_aec(parallel_env(config=config)), num_cycles=20)


@each_config
@pytest.mark.parametrize("others", ["shortest", "none"])
def test_the_single_robot_keeps_gymnasiums_rules(config: dict[str, Any], others: str) -> None:
    check_env(single(config=config, others=others), skip_render_check="ris" in config)


@each_config
def test_observations_lie_in_their_spaces(config: dict[str, Any]) -> None:
    view = parallel_env(config=config)
    seen, _ = view.reset(seed=2)
    while view.agents:
        assert all(view.observation_space(agent).contains(seen[agent]) for agent in seen)
        seen = view.step(sampled(view))[0]


@each_config
def test_the_parallel_view_is_the_world_bit_for_bit(config: dict[str, Any]) -> None:
    view = parallel_env(config=config, seed=5)
    whole = view.config
    world = World(Scenario.drawn(whole, 5), stream(9, Stream.WORLD))
    random = np.random.default_rng(1)
    seen, _ = view.reset(seed=9)
    world.reset()
    while view.agents:
        local = world.local_observations()
        for k in np.flatnonzero(world.driving[0]):
            np.testing.assert_array_equal(seen[f"robot_{k}"], local[0, k])
        np.testing.assert_array_equal(seen[AP], world.global_observation(local)[0])
        phase = random.integers(world.phase_actions, size=1)
        picks = random.integers(ActionSpace(whole.power.levels).count, size=(1, world.robots))
        picked = {f"robot_{k}": picks[0, k] for k in range(world.robots)}
        seen, paid, ended, out, infos = view.step({**picked, AP: phase[0]})
        outcome = world.step(phase, *ActionSpace(whole.power.levels).decode(picks))
        assert paid[AP] == outcome.global_reward[0]
        assert infos[AP]["sum_rate"] == outcome.rate.sum()
        assert (ended[AP], out[AP]) == (outcome.terminated[0], outcome.truncated[0])
        assert set(paid) == {AP, *(f"robot_{k}" for k in np.flatnonzero(outcome.drove[0]))}
        for k in np.flatnonzero(outcome.drove[0]):
            name = f"robot_{k}"
            assert paid[name] == outcome.local_reward[0, k]
            assert infos[name]["rate"] == outcome.rate[0, k]
            assert infos[name]["power_w"] == outcome.allocation.power_w[0, k]
            assert ended[name] == outcome.arrived[0, k]


def test_robots_leave_on_arrival_and_the_access_point_with_the_last() -> None:
    view = parallel_env(config={"robots": 2})
    starts = [beside(view, 1)[0], beside(view, 3)[1]]
    _, infos = view.reset(options={"starts_m": starts})
    assert [infos[name]["shortest_slots"] for name in view.robots] == [1, 3]
    moves = {"robot_0": EAST, "robot_1": EAST, AP: 0}
    _, paid, ended, out, infos = view.step(moves)
    assert ended == {"robot_0": True, "robot_1": False, AP: False}
    assert not any(out.values())
    assert paid["robot_0"] > 90
    assert infos["robot_0"]["arrived"]
    assert view.agents == ["robot_1", AP]
    seen, paid, *_ = view.step(moves)  # what robot_0 still says is not read
    assert set(paid) == {"robot_1", AP}
    np.testing.assert_array_equal(seen[AP][:8], 0.0)
    _, _, ended, out, _ = view.step(moves)
    assert ended == {"robot_1": True, AP: True}
    assert not any(out.values())
    assert view.agents == []
    assert view.step({}) == ({}, {}, {}, {}, {})


def test_time_runs_out_for_all_that_are_left() -> None:
    tasks = {"start_distance_m": 1.0}
    view = parallel_env(config={"robots": 2, "motion": {"max_slots": 2}, "tasks": tasks})
    view.reset(options={"starts_m": [beside(view, 2)[0], beside(view, 3)[1]]})
    moves = {"robot_0": EAST, "robot_1": EAST, AP: 0}
    view.step(moves)
    _, _, ended, out, _ = view.step(moves)
    assert ended == {"robot_0": True, "robot_1": False, AP: False}
    assert out == {"robot_0": False, "robot_1": True, AP: True}
    assert view.agents == []


def test_a_seed_begins_the_starts_anew_and_leaves_the_destinations() -> None:
    view = parallel_env(config={"robots": 6}, seed=3)
    goals = view.world.destinations.copy()
    view.reset(seed=7)
    first = view.world.cell.copy()
    view.reset()
    assert (view.world.cell != first).any()
    view.reset(seed=7)
    np.testing.assert_array_equal(view.world.cell, first)
    np.testing.assert_array_equal(view.world.destinations, goals)
    assert (parallel_env(config={"robots": 6}, seed=4).world.destinations[4:] != goals[4:]).any()


def test_single_robots_without_a_seed_start_differently() -> None:
    first, second = single(others="none"), single(others="none")
    starts = [[view.reset()[0].tolist() for _ in range(4)] for view in (first, second)]
    assert starts[0] != starts[1]


@pytest.mark.parametrize("view", [parallel_env, single], ids=["parallel", "single"])
def test_views_draw_the_floor(view: Any) -> None:
    made = view(config=on_small_floor({"robots": 2}), render_mode="rgb_array")
    made.reset(seed=0)
    first = made.render()
    assert first.shape == (480, 480, 3)
    assert first.dtype == np.uint8
    np.testing.assert_array_equal(made.render(), first)
    made.reset(seed=1)
    assert (made.render() != first).any()
    made.reset(seed=0)
    np.testing.assert_array_equal(made.render(), first)
    made.close()
    made.close()


def test_only_a_robot_that_ends_elsewhere_is_marked_as_not_arrived() -> None:
    world = parallel_env(config=on_small_floor({"robots": 2})).world
    goals = world.floor.centres()[world.destinations]
    ways = np.stack([goals, goals])[:, None].repeat(2, axis=1)
    ways[-1, 1, 0] += 1.0
    assert missed(ways[-1], goals).tolist() == [[False, False], [True, False]]

    def crosses(shown: Any) -> list[int]:
        figure = trajectory_figure(world.config, world.radio_map, shown, goals, ["a", "b"])
        return [sum(line.get_marker() == "X" for line in axes.lines) for axes in figure.axes[:2]]

    assert crosses(ways) == [0, 1]
    assert crosses(ways[:1]) == [0, 0]


@pytest.mark.parametrize("view", [parallel_env, single], ids=["parallel", "single"])
def test_views_describe_themselves_in_text(view: Any) -> None:
    made = view(config=on_small_floor({"robots": 2}), render_mode="ansi")
    made.reset(seed=0)
    text = made.render()
    assert text.startswith("slot 0 of 150, 2 of 2 driving")
    assert "robot_1 at" in text


def test_rendering_without_a_mode_warns() -> None:
    view = parallel_env()
    view.reset()
    with pytest.warns(UserWarning, match="render_mode"):
        assert view.render() is None


@pytest.mark.parametrize(
    "again", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))], ids=["deepcopy", "pickle"]
)
def test_copies_go_on_to_the_same_slots(again: Any) -> None:
    view = parallel_env(config=on_small_floor({"robots": 2}), render_mode="rgb_array")
    view.reset(seed=1)
    view.step(sampled(view))
    view.render()
    twin = again(view)
    moves = sampled(view)
    first, second = view.step(moves), twin.step(moves)
    assert first[1:] == second[1:]
    np.testing.assert_array_equal(first[0][AP], second[0][AP])
    np.testing.assert_array_equal(view.render(), twin.render())
    alone = single()
    alone.reset(seed=1)
    other = again(alone)
    assert alone.step(np.int64(3))[1:] == other.step(np.int64(3))[1:]
    np.testing.assert_array_equal(alone.reset()[0], other.reset()[0])


@each_config
def test_a_shortest_way_takes_the_single_robot_to_its_goal(config: dict[str, Any]) -> None:
    view = single(config={**config, "motion": {}})
    (_, info), world = view.reset(seed=4), view._fleet.world
    for _ in range(info["shortest_slots"]):
        there = world.slots_to_go[world.next_cell[world.cell[0, 0]], 0]
        direction = there.argmin()
        _, reward, terminated, truncated, info = view.step(
            np.int64(direction * view.config.power.levels)
        )
    assert terminated
    assert not truncated
    assert reward > 90
    with pytest.raises(gymnasium.error.ResetNeeded):
        view.step(np.int64(0))


def test_other_robots_arrive_on_time_and_end_nothing() -> None:
    view = single(config={"robots": 3})
    view.reset(seed=0)
    world = view._fleet.world
    shortest = world.floor.shortest_slots(world.cell[0], world.destinations)
    for slot in range(1, int(shortest[1:].max()) + 1):
        _, _, terminated, _, _ = view.step(np.int64(0 if slot % 2 else 6))
        np.testing.assert_array_equal(world.driving[0, 1:], shortest[1:] > slot)
        assert not terminated


def test_the_single_robot_is_truncated_at_the_time_limit() -> None:
    tasks = {"start_distance_m": 1.0}
    view = single(config={"robots": 1, "motion": {"max_slots": 3}, "tasks": tasks})
    view.reset(seed=0)
    ends = [view.step(np.int64(0))[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]


@pytest.mark.parametrize("order", ["import gymnasium, env", "import env, gymnasium"])
def test_importing_env_registers_in_any_order_and_draws_nothing(order: str) -> None:
    code = f"""
import sys
{order}
assert "env.apis" not in sys.modules, "env loads a view before it is used"
gymnasium.make("risfleet/SingleRobot-v0")
gymnasium.make("env:risfleet/SingleRobot-v0", others="none")
import pettingzoo
pettingzoo.make("parallel", "risfleet/Fleet-v0", absorbing=True)
assert "matplotlib" not in sys.modules, "a view loads matplotlib before it draws"
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_physics_runs_without_gymnasium() -> None:
    code = """
import sys
sys.modules["gymnasium"] = sys.modules["pettingzoo"] = sys.modules["matplotlib"] = None
import env.world, env.oracles, env.episode, env.local_env
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_views_are_names_of_the_package() -> None:
    assert env.RISFleetParallelEnv is RISFleetParallelEnv
    assert env.SingleRobotEnv is SingleRobotEnv
    assert env.SingleRobotVectorEnv.__module__ == "env.apis.single_robot_vector"
    with pytest.raises(AttributeError, match="nothing"):
        _ = env.nothing


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"robots": 0}, "env.robots=0: allowed is a number from 1 to 64"),
        ({"robots": "2"}, "env.robots='2': allowed is a whole number"),
        ({"robots": True}, "env.robots=True: allowed is a whole number"),
        ({"ris": {"sides": 3}}, r"env.ris.sides=3: allowed keys are position_m, side"),
        ({"ris": 3}, "env.ris=3: allowed is a mapping"),
        ({"ris": {"response": 1}}, "env.ris.response=1: allowed is a word"),
        ({"noise": {"bandwidth_hz": "x"}}, "env.noise.bandwidth_hz='x': allowed is a number"),
        ({"ap": {"position_m": 1.0}}, "env.ap.position_m=1.0: allowed is a list"),
        ({"power": {"levels": 2}}, "env.power.levels=2: allowed is at least env.robots=3"),
        (EnvConfig(robots=99), "env.robots=99: allowed is a number from 1 to 64"),
    ],
)
def test_a_wrong_configuration_is_named(config: Any, message: str) -> None:
    for view in (RISFleetParallelEnv, SingleRobotEnv):
        with pytest.raises(ValueError, match=message):
            view(config)


def test_nested_fields_may_be_tuples_or_dataclasses() -> None:
    position = (15.0, 30.0, 2.5)
    config = env.checked_config({"ris": RisConfig(side=0), "ap": {"position_m": position}})
    assert config.ris.side == 0
    assert config.ap.position_m == list(position)


def test_infos_have_the_same_keys_and_kinds_at_a_reset_as_at_a_step() -> None:
    view = parallel_env(config={"robots": 3})
    _, first = view.reset(seed=0)
    *_, after = view.step(sampled(view))
    kinds = [{n: {k: type(v) for k, v in i.items()} for n, i in x.items()} for x in (first, after)]
    assert kinds[0] == kinds[1]
    alone = single(config={"robots": 3})
    _, first = alone.reset(seed=0)
    *_, after = alone.step(np.int64(0))
    assert {k: type(v) for k, v in first.items()} == {k: type(v) for k, v in after.items()}


def test_infos_of_a_reset_say_that_nothing_has_been_sent_and_how_long_the_way_is() -> None:
    view = parallel_env(config={"robots": 2, "ris": {"side": 0}})
    _, infos = view.reset(options={"starts_m": [beside(view, 3)[0], beside(view, 5)[1]]})
    assert [infos[name]["shortest_slots"] for name in view.robots] == [3, 5]
    sent = [infos[name][key] for name in view.robots for key in ("rate", "power_w", "arrived")]
    assert sent == [0.0, 0.0, False] * 2
    assert infos[AP] == {"sum_rate": 0.0, "projected": False, "margin_dropped": False}
    *_, after = view.step({"robot_0": EAST, "robot_1": EAST, AP: 0})
    assert [after[name]["shortest_slots"] for name in view.robots] == [2, 4]
    for name in view.robots:  # without an RIS the channel of the first slot is the direct one
        assert after[name]["gain_db"] == pytest.approx(infos[name]["gain_db"])
    alone = single(config={"robots": 2})
    _, info = alone.reset(seed=0)
    assert (info["phase"], info["sum_rate"]) == (-1, 0.0)


@pytest.mark.parametrize("view", [parallel_env, single], ids=["parallel", "single"])
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"start_m": [[1.0, 1.0]]}, "options.start_m=[[1.0, 1.0]]: allowed is the option starts_m"),
        ({"starts_m": [[1.0, 1.0]], "seed": 3}, "options.seed=3: allowed is the option starts_m"),
        ({3: 4}, "options.3=4: allowed is the option starts_m alone"),
        ({"starts_m": [[1.0], [1.0, 2.0]]}, "options.starts_m=[[1.0], [1.0, 2.0]]: allowed is 1 "),
        ({"starts_m": "here"}, "options.starts_m='here': allowed is 1 positions [x, y] in m"),
        ("starts_m", "options='starts_m': allowed is a mapping with starts_m"),
    ],
)
def test_an_unknown_option_of_a_reset_is_named(view: Any, options: Any, said: str) -> None:
    made = view(config=on_small_floor({"robots": 1}))
    made.reset(seed=0)
    with pytest.raises(ValueError, match=r"^options") as caught:
        made.reset(options=options)
    assert str(caught.value).startswith(said)
    assert "\n" not in str(caught.value)
    for fine in (None, {}, {"starts_m": None}, {"starts_m": [[1.0, 1.0]]}):
        made.reset(options=fine)


def test_an_option_that_is_refused_leaves_the_episode_and_the_starts_to_come() -> None:
    view, twin = parallel_env(config={"robots": 2}), parallel_env(config={"robots": 2})
    for one in (view, twin):
        one.reset(seed=5)
    with pytest.raises(ValueError, match=r"options\.start_m"):
        view.reset(seed=9, options={"start_m": []})
    np.testing.assert_array_equal(view.world.cell, twin.world.cell)
    view.reset()
    twin.reset()
    np.testing.assert_array_equal(view.world.cell, twin.world.cell)


def test_wrong_calls_are_named() -> None:
    with pytest.raises(ValueError, match="render_mode='human': allowed is None, rgb_array, ansi"):
        parallel_env(render_mode="human")
    with pytest.raises(ValueError, match="others='random': allowed is shortest or none"):
        SingleRobotEnv(others="random")
    view = parallel_env(config={"robots": 1})
    with pytest.raises(RuntimeError, match="before reset"):
        view.step({})
    with pytest.raises(gymnasium.error.ResetNeeded):
        SingleRobotEnv().step(np.int64(0))
    view.reset()
    with pytest.raises(ValueError, match=r"action of robot_0=24: allowed .* 0 to 23"):
        view.step({"robot_0": 24, AP: 0})
    with pytest.raises(ValueError, match=r"action of ap=None: allowed .* 0 to 3"):
        view.step({"robot_0": 0})
    goal = view.world.floor.centres()[view.world.destinations].tolist()
    for starts in ([[1.0, 1.0, 1.0]], [[40.0, 1.0]], [[float("nan"), 1.0]], goal):
        for given in (starts, np.array(starts)):
            with pytest.raises(
                ValueError, match=r"^options\.starts_m=\[\[.*\]\]: allowed is [^\n]*$"
            ):
                view.reset(options={"starts_m": given})
