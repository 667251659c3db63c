"""One agent for everything: what it decides is done, what it learns from, and how it is kept."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from safetensors.numpy import load_file

from conf import Config, weight_shapes
from env.mdp.actions import ActionSpace
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import StepResult, World
from experiments.runtimes import local
from training.controllers.central import BranchingAgent, CentralAgent, JointAgent, joint_reward
from training.controllers.policies import Exploration, PolicyWeights, frozen_policy
from training.coordinator import Coordinator
from training.evaluation import Evaluator
from training.run_folder import RunFolder

Tiny = Callable[..., Config]
KINDS: dict[str, type[CentralAgent]] = {"centralized": JointAgent, "branching": BranchingAgent}


@pytest.fixture(params=["centralized", "branching"])
def config(request: pytest.FixtureRequest, tiny: Tiny) -> Config:
    """Two robots and one agent for everything."""
    changes = {"scheme.agents": request.param, "strategy.name": "none", "env.robots": 2}
    return tiny({**changes, "env.power.levels": 3, "train.max_ticks": 120})


class Spied(World):
    """A world that keeps what it was asked to do, and who was driving."""

    steps: list[SimpleNamespace]

    def step(self, phase_action: Any, direction: Any, level: Any) -> StepResult:
        drove = self.driving[0].copy()
        outcome = super().step(phase_action, direction, level)
        move = SimpleNamespace(direction=direction[0], level=level[0], drove=drove)
        self.steps.append(
            SimpleNamespace(phase=int(phase_action[0]), outcome=outcome, **vars(move))
        )
        return outcome


def world_of(config: Config) -> Spied:
    world = Spied(Scenario.drawn(config.env, config.seed), stream(config.seed, Stream.WORLD))
    world.steps = []
    return world


class Unwatched:
    """An observer that looks away."""

    def on_start(self) -> None: ...

    def on_episode(self, progress: Any, measures: Any) -> None: ...

    def on_window(self, progress: Any, robots: NDArray[np.float32], ap: Any) -> None:
        assert robots.shape == (2, 2, 0)


def played(config: Config) -> tuple[CentralAgent, Spied, list[tuple[Any, ...]]]:
    """A run, its world's steps, and what the agent's DQN learned from."""
    agent, world = KINDS[config.scheme.agents](config), world_of(config)
    learned: list[tuple[Any, ...]] = []
    learn = agent.agent.learn

    def spied(*given: Any) -> Any:
        learned.append(copy.deepcopy(given))
        return learn(*given)

    agent.agent.learn = spied
    Coordinator(config, world, agent, agent.fleet, None, Unwatched()).run(
        np.zeros((2, 0), np.float32)
    )
    return agent, world, learned


def test_the_reward_for_everything_is_the_papers() -> None:
    outcome = SimpleNamespace(
        local_reward=np.array([[1.0, -2.0, 4.0]]), global_reward=np.array([20.0])
    )
    assert joint_reward(outcome, 0.1) == [5.0]


def test_what_it_decided_is_done_and_learned_from(config: Config) -> None:
    _, world, learned = played(config)
    assert len(world.steps) == len(learned) == 120
    assert any(not step.drove.all() for step in world.steps)
    levels = config.env.power.levels
    for step, (_, chosen, reward, *_rest) in zip(world.steps, learned, strict=True):
        if config.scheme.agents == "centralized":
            phase, robots = (part[0] for part in ActionSpace(levels).joint_decode(chosen, 2))
            assert reward == joint_reward(step.outcome, 0.1)
        else:
            phase, robots = chosen[0, 0], chosen[0, 1:]
            assert reward[0, 0] == step.outcome.global_reward[0]
            np.testing.assert_array_equal(reward[:, 1:], step.outcome.local_reward)
            np.testing.assert_array_equal(robots == -1, ~step.drove)
        direction, level = ActionSpace(levels).decode(robots)
        assert phase == step.phase
        np.testing.assert_array_equal(direction[step.drove], step.direction[step.drove])
        np.testing.assert_array_equal(level[step.drove], step.level[step.drove])


def test_a_transition_ends_for_a_head_when_its_robot_arrives_and_for_all_with_the_last(
    config: Config,
) -> None:
    _, world, learned = played(config)
    for step, (*_, terminal, active) in zip(world.steps, learned, strict=True):
        outcome = step.outcome
        if config.scheme.agents == "centralized":
            assert terminal == outcome.terminated
        else:
            assert terminal.tolist() == [[outcome.terminated[0], *outcome.arrived[0]]]
            assert active.tolist() == [[True, *outcome.drove[0]]]
    assert any(step.outcome.arrived.any() for step in world.steps)


def test_heads_that_share_learn_from_one_reward(tiny: Tiny) -> None:
    changes = {"scheme.agents": "branching", "scheme.heads": "shared", "scheme.global_share": 0.5}
    config = tiny({**changes, "strategy.name": "none", "env.robots": 2, "train.max_ticks": 40})
    agent, world, learned = played(config)
    assert agent.agent.heads.discounts == (0.8, 0.8, 0.8)
    for step, (_, _, reward, *_rest) in zip(world.steps, learned, strict=True):
        assert reward.tolist() == [[joint_reward(step.outcome, 0.5)[0]] * 3]


def test_the_part_of_an_arrived_robot_has_no_effect(config: Config) -> None:
    world = world_of(config)
    world.reset()
    world.driving = np.array([[True, False]])
    brought = [
        copy.copy(world).step(np.array([1]), np.array([[2, other]]), np.array([[1, other]]))
        for other in (1, 3)
    ]
    for name in ("rate", "local_reward", "global_reward", "arrived"):
        np.testing.assert_array_equal(getattr(brought[0], name), getattr(brought[1], name))


def test_a_frozen_policy_decides_as_the_agent_does(config: Config) -> None:
    agent, _, _ = played(config)
    world = world_of(config)
    policy, weights = frozen_policy(config, world), agent.weights()[0]
    epsilon = config.agent.epsilon
    for _ in range(30):
        world.reset()
        for _ in range(5):
            agent.fleet.driving = world.driving
            agent._epsilon = type(epsilon)(0.0, 0.0, 1)
            phase = agent.act(world.global_observation(), 10)
            direction, level = ActionSpace(config.env.power.levels).decode(agent.fleet.orders)
            frozen = policy(world, PolicyWeights(weights[None], weights), Exploration(0, (0.0,), 1))
            driving = world.driving
            assert phase == frozen.phase
            np.testing.assert_array_equal(direction[driving], frozen.direction[driving])
            np.testing.assert_array_equal(level[driving], frozen.level[driving])
            world.step(phase, direction, level)


def test_a_run_leaves_what_every_run_leaves(config: Config, tmp_path: Path) -> None:
    summary = local.train(config, RunFolder(tmp_path / "run"))
    arrays = load_file(tmp_path / "run" / "weights.safetensors")
    assert {name: array.shape for name, array in arrays.items()} == weight_shapes(config)
    assert arrays["robots"].shape == (2, 2, 0)
    assert summary["scheme"]["agents"] == config.scheme.agents
    assert summary["ticks"] == 120
    again = local.train(config, RunFolder(tmp_path / "again"))
    assert again["digest"] == summary["digest"]
    assert again["evaluation"] == summary["evaluation"]


def test_exploring_takes_a_joint_action_whole_and_heads_one_by_one(config: Config) -> None:
    """With epsilon 1/2 and many worlds: how often robots 0 and 1 both leave the greedy action."""
    evaluator = Evaluator(config, episodes=4000)
    world = evaluator.world
    world.reset(np.tile(evaluator.starts[:1], (4000, 1)))
    agent = KINDS[config.scheme.agents](config)
    weights = PolicyWeights(np.zeros((1, 0), np.float32), agent.weights()[0])
    policy = frozen_policy(config, world)
    greedy = policy(world, weights, Exploration(0, (0.0,), 4000))
    random = policy(world, weights, Exploration(0, (0.5,), 4000))
    left = greedy.direction != random.direction
    both = 0.5 * 0.75**2 if config.scheme.agents == "centralized" else (0.5 * 0.75) ** 2
    np.testing.assert_allclose(left.mean(axis=0), 0.5 * 0.75, atol=0.03)
    np.testing.assert_allclose(left.all(axis=1).mean(), both, atol=0.03)
