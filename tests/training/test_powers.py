"""Who picks the powers: the robots, the access point's DQN, or a search in each slot."""

from __future__ import annotations

import copy
from collections.abc import Callable
from math import comb
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from safetensors.numpy import load_file

from agent import epsilon_at
from conf import Config, ap_actions, joint_actions, robot_actions, weight_shapes
from env.episode import EpisodeMeasures
from env.mdp.actions import ActionSpace
from env.oracles import per_slot
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import StepResult, World
from experiments.runtimes import local
from training.controllers.access_point import AccessPoint
from training.controllers.policies import Exploration, PolicyWeights, frozen_policy
from training.controllers.schemes import build_central, build_ris_controller
from training.controllers.service import Service
from training.coordinator import Coordinator
from training.evaluation import Evaluator
from training.run_folder import RunFolder

Tiny = Callable[..., Config]
AGENTS = ("federated", "centralized", "branching")
OTHERS = ("ap", "search")
COMBINATIONS = [[4, 3, 2], [4, 3, 1], [4, 2, 1], [3, 2, 1]]
"""Three of four levels, the strongest robot's first."""


def world_of(config: Config, worlds: int = 1) -> World:
    """Worlds with robots anywhere."""
    generator = stream(config.seed, Stream.WORLD)
    world = World(Scenario.drawn(config.env, config.seed), generator, worlds)
    world.reset()
    return world


def powered(tiny: Tiny, power: str, agents: str = "federated", **changes: Any) -> Config:
    """The tiny task with powers of a kind; one agent for everything has two robots."""
    given: dict[str, Any] = {"scheme.power": power, "scheme.agents": agents}
    if agents != "federated":
        given |= {"strategy.name": "none", "env.robots": 2, "env.power.levels": 3}
    return tiny({**given, **{key.replace("__", "."): value for key, value in changes.items()}})


# --- What is served -------------------------------------------------------------------------------


def test_robots_serve_themselves_by_default(tiny: Tiny) -> None:
    world, picks = world_of(tiny(), 5), np.arange(15).reshape(5, 3) % 6 + 1
    phase, level = Service(tiny())(world, np.arange(5) % 4, picks)
    np.testing.assert_array_equal(phase, np.arange(5) % 4)
    np.testing.assert_array_equal(level, picks)


def test_an_action_of_both_is_a_phase_and_powers_by_rank(tiny: Tiny) -> None:
    """Every action with three, two, one and no robots driving."""
    config = powered(tiny, "ap", env__power__levels=4)
    assert ap_actions(config) == 4 * 4
    world = world_of(config, 16)
    actions = np.arange(16)
    for driving in ([1, 1, 1], [1, 0, 1], [0, 1, 1], [0, 0, 1], [0, 0, 0]):
        world.driving = np.tile(np.array(driving, bool), (16, 1))
        phase, level = Service(config)(world, actions, np.full((16, 3), 99))
        gain = per_slot.phase_gains(world)
        for row, action in enumerate(actions):
            combination = COMBINATIONS[action % 4]
            assert phase[row] == action // 4
            falling = np.argsort(-gain[row, phase[row]], kind="stable")
            order = [k for k in falling if driving[k]]
            expected = [1, 1, 1]
            for robot, own in zip(order, combination[3 - len(order) :], strict=True):
                expected[robot] = own
            assert level[row].tolist() == expected


def test_powers_that_were_picked_for_all_are_sent_as_they_are(tiny: Tiny) -> None:
    config = powered(tiny, "ap", env__power__sic_margin=0.0)
    world, actions = world_of(config, 80), np.arange(80)
    world.driving = np.random.default_rng(0).random((80, 3)) < 0.7
    phase, level = Service(config)(world, actions, np.ones((80, 3), int))
    assert not world.step(phase, np.zeros((80, 3), int), level).allocation.projected.any()


@pytest.mark.parametrize("metric", ["qos", "qoe"])
def test_a_search_serves_no_less_than_any_picks_under_its_phase(tiny: Tiny, metric: str) -> None:
    config = powered(tiny, "search", env__metric=metric)
    world, draw = world_of(config, 40), np.random.default_rng(0)
    phase, level = Service(config)(world, np.arange(40) % 4, np.ones((40, 3), int))
    np.testing.assert_array_equal(phase, np.arange(40) % 4)
    best = copy.copy(world).step(phase, np.zeros((40, 3), int), level).global_reward
    for _ in range(30):
        picks = draw.integers(1, 7, size=(40, 3))
        reward = copy.copy(world).step(phase, np.zeros((40, 3), int), picks).global_reward
        assert (reward <= best + 1e-9).all()


def test_a_search_counts_robots_as_the_world_says(
    tiny: Tiny, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = powered(tiny, "search")
    world, phase = world_of(config, 6), np.zeros(6, int)
    weights = np.tile([1.0, 5.0, 0.2], (6, 1))
    monkeypatch.setattr(World, "rate_weights", weights)
    _, level = Service(config)(world, phase, np.ones((6, 3), int))
    np.testing.assert_array_equal(level, per_slot.best_powers(world, phase, weights))
    assert (level != per_slot.best_powers(world, phase)).any()


def test_an_oracle_that_searches_powers_finds_phase_and_powers_together(tiny: Tiny) -> None:
    config = powered(tiny, "search", scheme__phase="oracle")
    world = world_of(config, 20)
    phase, level = Service(config)(world, np.zeros(20, int), np.ones((20, 3), int))
    expected = per_slot.best_phase_and_powers(world)
    np.testing.assert_array_equal(phase, expected[0])
    np.testing.assert_array_equal(level, expected[1])


@pytest.mark.parametrize("power", OTHERS)
def test_under_oma_there_is_one_combination(tiny: Tiny, power: str) -> None:
    config = powered(tiny, power, env__access="oma", env__power__levels=2)
    assert ap_actions(config) == 4
    phase, level = Service(config)(world_of(config, 4), np.arange(4), np.full((4, 3), 2))
    np.testing.assert_array_equal(phase, np.arange(4))
    np.testing.assert_array_equal(level, 1)


@pytest.mark.parametrize("power", OTHERS)
@pytest.mark.parametrize("fading", ["static", "slot"])
def test_worlds_are_served_as_each_alone(tiny: Tiny, power: str, fading: str) -> None:
    config = powered(tiny, power, env__channel__fading=fading)
    world, service = world_of(config, 7), Service(config)
    world.driving = np.random.default_rng(1).random((7, 3)) < 0.7
    actions = np.random.default_rng(2).integers(ap_actions(config), size=7)
    picks = np.ones((7, 3), int)
    phase, level = service(world, actions, picks)
    one, state = world_of(config), world.state()
    for row in range(7):
        alone = {k: v[:, [row]] if k == "fading" else v[[row]] for k, v in state.items()}
        one.restore(alone)
        served = service(one, actions[[row]], picks[[row]])
        assert served[0] == phase[row]
        np.testing.assert_array_equal(served[1][0], level[row])


# --- Who learns what ------------------------------------------------------------------------------


def test_actions_are_as_many_as_the_scheme_leaves(tiny: Tiny) -> None:
    for power, robot, ap in (("robots", 24, 4), ("ap", 4, 4 * comb(6, 3)), ("search", 4, 4)):
        config = powered(tiny, power)
        assert (robot_actions(config).count, ap_actions(config)) == (robot, ap)
        assert joint_actions(config) == ap * robot**3


class Spied(World):
    """A world that keeps what it was asked to do."""

    asked: list[tuple[Any, ...]]

    def step(self, phase_action: Any, direction: Any, level: Any) -> StepResult:
        before = copy.copy(self)
        self.asked.append((before, phase_action, direction, level))
        return super().step(phase_action, direction, level)


def learned_by(
    monkeypatch: pytest.MonkeyPatch, agent: Any, play: Callable[[], Any]
) -> list[NDArray[np.int64]]:
    """The actions that an agent's DQN learned from while a run was played."""
    actions: list[NDArray[np.int64]] = []
    learn = agent.learn

    def spied(state: Any, action: Any, *rest: Any) -> Any:
        actions.append(np.array(action))
        return learn(state, action, *rest)

    monkeypatch.setattr(agent, "learn", spied)
    play()
    return actions


@pytest.mark.parametrize("power", OTHERS)
def test_the_access_points_dqn_learns_from_its_own_action(
    tiny: Tiny, power: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = powered(tiny, power)
    scenario = Scenario.drawn(config.env, config.seed)
    world = Spied(scenario, stream(config.seed, Stream.WORLD))
    world.asked = []
    ap, fleet = AccessPoint(config), Idle()
    run = Coordinator(config, world, ap, fleet, None, Unwatched())
    learned = learned_by(monkeypatch, ap.agent, lambda: run.run(np.zeros((2, 0), np.float32)))
    assert len(learned) == len(world.asked) == 100
    service, phases = Service(config), set()
    for action, (before, phase, direction, level) in zip(learned, world.asked, strict=True):
        served = service(before, action.astype(np.int64), np.ones((1, 3), int))
        np.testing.assert_array_equal(phase, served[0])
        np.testing.assert_array_equal(level, served[1])
        np.testing.assert_array_equal(direction, [[3, 3, 3]])
        phases.add(int(action[0]))
    assert (max(phases) >= 4) == (power == "ap")


class Idle:
    """Three robots that all move the same way, whatever comes."""

    def send_step(self, *step: Any) -> None: ...

    def actions(self, tick: int) -> NDArray[np.int32]:
        return np.full(3, 3, np.int32)

    def upload(self, window: int) -> NDArray[np.float32]:
        return np.zeros((3, 2, 0), np.float32)


class Unwatched:
    """An observer that looks away."""

    def on_start(self) -> None: ...

    def on_episode(self, *told: Any) -> None: ...

    def on_window(self, *told: Any) -> None: ...


def test_a_level_that_robots_no_longer_pick_is_refused(tiny: Tiny) -> None:
    config = powered(tiny, "search")
    fleet = Idle()
    fleet.actions = lambda tick: np.array([0, 4, 0], np.int32)
    run = Coordinator(config, world_of(config), AccessPoint(config), fleet, None, Unwatched())
    with pytest.raises(ValueError, match="tick 0: action 4 of robot 1, of -1 to 3"):
        run.run(np.zeros((2, 0), np.float32))


@pytest.mark.parametrize("power", OTHERS)
@pytest.mark.parametrize("agents", AGENTS[1:])
def test_one_agent_for_everything_decides_as_when_frozen(
    tiny: Tiny, agents: str, power: str
) -> None:
    config = powered(tiny, power, agents)
    agent, world = build_central(config), world_of(config)
    weights, late = agent.weights()[0], 10**9
    assert epsilon_at(config.agent.epsilon, late) < 0.1
    agent._epsilon = type(config.agent.epsilon)(0.0, 0.0, 1)
    policy, space = frozen_policy(config, world), ActionSpace(1)
    for _ in range(40):
        agent.fleet.driving = world.driving
        action = agent.act(world.global_observation(), late)
        assert 0 <= action < ap_actions(config)
        direction, picks = space.decode(agent.fleet.orders.astype(np.int64))
        phase, level = agent.serve(world, action, picks)
        frozen = policy(world, PolicyWeights(weights[None], weights), Exploration(0, (0.0,), 1))
        driving = world.driving
        assert phase == frozen.phase
        np.testing.assert_array_equal(direction[driving], frozen.direction[driving])
        np.testing.assert_array_equal(level[driving], frozen.level[driving])
        if world.step(phase, direction, level).terminated.all():
            world.reset()


# --- Runs -----------------------------------------------------------------------------------------


def same(one: EpisodeMeasures, other: EpisodeMeasures) -> bool:
    pairs = ((vars(one)[name], vars(other)[name]) for name in vars(one))
    return all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


@pytest.mark.parametrize("power", OTHERS)
@pytest.mark.parametrize("agents", AGENTS)
def test_a_run_is_a_run_whoever_picks_powers(
    tiny: Tiny, agents: str, power: str, tmp_path: Path
) -> None:
    config = powered(tiny, power, agents, train__max_ticks=60)
    summary = local.train(config, RunFolder(tmp_path / "run"))
    assert summary["scheme"]["power"] == power
    assert summary["digest"] == local.train(config, RunFolder(tmp_path / "again"))["digest"]
    arrays = load_file(tmp_path / "run" / "weights.safetensors")
    assert {name: array.shape for name, array in arrays.items()} == weight_shapes(config)
    online = arrays["robots"][:, 0], arrays["ap"][0]
    evaluator = Evaluator(config)
    (measures,) = evaluator.play(*online, (0.0,))
    assert measures.summary()["ee"] == summary["evaluation"]["greedy"]["ee"]
    assert same(evaluator.play(*online, (0.3, 0.0))[1], measures)


@pytest.mark.parametrize("rule", ["random", "fixed", "oracle"])
def test_a_rule_for_phases_goes_with_searched_powers(tiny: Tiny, rule: str, tmp_path: Path) -> None:
    config = powered(tiny, "search", scheme__phase=rule)
    summary = local.train(config, RunFolder(tmp_path / "run"))
    assert summary["ticks"] == 100
    world = world_of(config)
    controller = build_ris_controller(config, world)
    action = controller.act(np.zeros((1, 24), np.float32), 0)
    phase, level = controller.serve(world, action, np.ones((1, 3), int))
    np.testing.assert_array_equal(level, per_slot.best_powers(world, phase))
    arrays = load_file(tmp_path / "run" / "weights.safetensors")
    assert arrays["ap"].shape == (2, 0)
