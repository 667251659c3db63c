"""Frozen policies act on what environments give, as evaluations play them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import risfleet
from conf import ConfigError
from env import RISFleetParallelEnv
from training.evaluation import Evaluator
from training.policy import Policy

WEIGHTS = Path(__file__).parents[2] / "results" / "weights"


@pytest.fixture
def run(tiny_run: Path) -> risfleet.Run:
    return risfleet.load(tiny_run)


def driven(run: risfleet.Run, decides: str, episodes: int) -> list[tuple[float, int]]:
    """Success and slots of an evaluation's episodes, driven in the environment."""
    evaluator = Evaluator(run.config, episodes=episodes)
    centres_m, found = evaluator.world.floor.centres(), []
    fleet = run.make_env()
    for start in evaluator.starts:
        seen, _ = fleet.reset(options={"starts_m": centres_m[start]})
        while fleet.agents:
            chosen = run.policy.act(seen) if decides == "act" else run.policy.decide(fleet)
            seen, *_ = fleet.step(chosen)
        found.append(((~fleet.world.driving).mean(), int(fleet.world.slot[0])))
    return found


@pytest.mark.parametrize(
    ("weights", "decides"), [(None, "act"), (None, "decide"), ("k3-best", "decide")]
)
def test_driving_in_the_environment_is_what_an_evaluation_plays(
    tiny_run: Path, weights: str | None, decides: str
) -> None:
    run = risfleet.load(WEIGHTS / weights if weights else tiny_run)
    played = run.evaluate(episodes=3).episodes
    assert played is not None
    expected = list(zip(played.success, played.slots, strict=True))
    assert driven(run, decides, 3) == expected


@pytest.mark.parametrize(
    "overrides",
    [
        ["baseline=centralized", "env.robots=1"],
        ["baseline=branching"],
        ["scheme.phase=random"],
        ["scheme.phase=oracle"],
        ["scheme.power=ap"],
        ["baseline=shortest_canonical"],
    ],
)
def test_every_scheme_decides_in_the_environment(
    tiny_overrides: tuple[str, ...], overrides: list[str]
) -> None:
    from conf import weight_shapes

    config = risfleet.compose([*tiny_overrides, *overrides])
    shapes = weight_shapes(config)
    generator = np.random.default_rng(0)
    robots, ap = (generator.normal(size=shapes[n]).astype(np.float32) for n in ("robots", "ap"))
    policy = Policy(config, robots[:, 0], ap[0])
    fleet = RISFleetParallelEnv(config.env, seed=config.seed)
    fleet.reset(seed=0)
    for _ in range(3):
        chosen = policy.decide(fleet, epsilon=0.5)
        assert [*chosen] == fleet.agents
        fleet.step(chosen)


def test_shapes_go_through_and_rows_do_not_depend_on_each_other(run: risfleet.Run) -> None:
    robots, size = run.config.env.robots, run.make_env().observation_space("robot_0").shape[0]
    seen = np.random.default_rng(1).normal(size=(4, 5, robots, size))
    actions = run.policy.act(seen)
    assert actions.shape == (4, 5, robots)
    assert (actions[2, 3] == run.policy.act(seen[2, 3])).all()
    one = run.policy.act({"robot_1": seen[2, 3, 1].astype(np.float32)})
    assert one == {"robot_1": actions[2, 3, 1]}


def test_exploration_is_drawn_from_what_is_given(run: risfleet.Run) -> None:
    fleet = run.make_env()
    seen, _ = fleet.reset(seed=0)
    local = np.repeat(fleet.world.local_observations(), 500, axis=0)
    greedy = run.policy.act(local)
    drawn = [run.policy.act(local, 0.5, np.random.default_rng(2)) for _ in range(2)]
    assert (drawn[0] == drawn[1]).all()
    assert 0.4 < (drawn[0] != greedy).mean() < 0.55
    everything = run.policy.act(local, epsilon=1.0)
    assert {*everything.ravel()} == {*range(fleet.action_space("robot_0").n)}
    phases = run.access_point.act(np.repeat(seen["ap"][None], 500, axis=0), epsilon=1.0)
    assert {*phases} == {*range(fleet.action_space("ap").n)}


def test_robots_that_pick_no_powers_ask_for_the_highest() -> None:
    run = risfleet.load(WEIGHTS / "k4-best")
    fleet = run.make_env()
    seen, _ = fleet.reset(seed=0)
    levels = run.config.env.power.levels
    acted, decided = run.policy.act(seen), run.policy.decide(fleet)
    for name in fleet.robots:
        assert acted[name] % levels == 0
        assert acted[name] // levels == decided[name] // levels
    assert acted["ap"] == decided["ap"]


def test_what_does_not_fit_is_refused(run: risfleet.Run) -> None:
    with pytest.raises(ValueError, match=r"shape \(2, 5\): allowed is \(..., 3, 5\)"):
        run.policy.act(np.zeros((2, 5)))
    with pytest.raises(ValueError, match="'robot_7' is no agent: allowed are robot_0"):
        run.policy.act({"robot_7": np.zeros(5, np.float32)})
    with pytest.raises(ValueError, match=r"epsilon=1\.5: allowed is a number from 0 to 1"):
        run.policy.act(np.zeros((3, 5)), epsilon=1.5)
    with pytest.raises(ConfigError, match="2 robots, not 3"):
        run.policy.decide(risfleet.make_env("env.robots=2"))


def test_agents_without_a_network_are_named(tiny_overrides: tuple[str, ...]) -> None:
    joint = risfleet.compose([*tiny_overrides, "baseline=branching"])
    ruled = risfleet.compose([*tiny_overrides, "scheme.phase=random"])
    nothing = np.zeros((3, 1), np.float32), np.zeros(1, np.float32)
    with pytest.raises(ConfigError, match=r"scheme\.agents=branching, which leaves robots no"):
        Policy(joint, *nothing).act(np.zeros((3, 5)))
    with pytest.raises(ConfigError, match=r"scheme\.phase=random, which leaves the access point"):
        _ = Policy(ruled, *nothing).access_point
