"""The world's step, alone, in a batch and as a vector environment, beside CartPole; radio maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import gymnasium
import numpy as np

import env  # noqa: F401 - registers the single robot
from agent import single_threaded
from benchmarks.result import Result, Threshold, micro, take_turns
from conf import compose
from env.config import EnvConfig
from env.radio.radio_map import build_radio_map
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World

BATCH = 256
MADE = 512
VS_CARTPOLE = (
    "processor time of World.step with rewards and the observations of 3 robots and AP, over that"
    " of a CartPole-v1 step; random actions, resets included, blocks in turn"
)
BATCHED = f"world steps per processor second of {BATCH} worlds in a batch over one world"

VECTOR = (
    f"robots that drive in a slot of {BATCH} risfleet/SingleRobot-v0 in one vector environment, per"
    " processor second; K = 3, random actions, resets, observations and infos included"
)
VS_VECTOR = (
    f"the same over steps per processor second of {BATCH} CartPole-v1 in one, blocks in turn"
)
VS_SINGLE = "the same over steps per processor second of one CartPole-v1, blocks in turn"

MAP = (
    "processor time of the radio map of M = 1,600 elements with exact distances, 3,600 cells, over"
    " that of 100,000 CartPole-v1 steps"
)
CODEBOOK = f"{MAP}; with a codebook of 6 x 6 beams"


class Walk:
    """Worlds under random actions, begun anew once every episode has ended."""

    def __init__(self, scenario: Scenario, worlds: int) -> None:
        self._world = World(scenario, stream(0, Stream.WORLD), worlds)
        space, self._tick = scenario.actions, 0
        rng = np.random.default_rng(0)
        chosen = rng.integers(space.count, size=(MADE, worlds, self._world.robots))
        self._moves = [*zip(*space.decode(chosen), strict=True)]
        self._phases = rng.integers(self._world.phase_actions, size=(MADE, worlds))
        self._world.reset()

    def __call__(self, steps: int) -> None:
        """Takes joint steps in every world."""
        world = self._world
        for _ in range(steps):
            at = self._tick % MADE
            self._tick += 1
            outcome = world.step(self._phases[at], *self._moves[at])
            world.global_observation(world.local_observations())
            if (outcome.terminated | outcome.truncated).all():
                world.reset()


class CartPole:
    """Gymnasium's CartPole-v1 as ``gymnasium.make`` gives it, under random actions."""

    def __init__(self) -> None:
        self._env = gymnasium.make("CartPole-v1")
        self._moves = np.random.default_rng(0).integers(2, size=MADE).tolist()
        self._tick = 0
        self._env.reset(seed=0)

    def __call__(self, steps: int) -> None:
        """Takes steps."""
        for _ in range(steps):
            _, _, terminated, truncated, _ = self._env.step(self._moves[self._tick % MADE])
            self._tick += 1
            if terminated or truncated:
                self._env.reset()


class Vector:
    """256 environments as ``make_vec`` gives them, under random actions."""

    def __init__(self, name: str) -> None:
        self._env = gymnasium.make_vec(
            name, num_envs=BATCH, vectorization_mode="vector_entry_point"
        )
        self._env.action_space.seed(0)
        self._moves = [self._env.action_space.sample() for _ in range(MADE)]
        self._tick = 0
        self._env.reset(seed=0)

    def __call__(self, steps: int) -> None:
        """Takes steps in every environment."""
        for _ in range(steps):
            self._env.step(self._moves[self._tick % MADE])
            self._tick += 1


class Robots(Vector):
    """The single robot 256 times; counts the robots that drive."""

    def __init__(self) -> None:
        super().__init__("risfleet/SingleRobot-v0")
        self._driven = 0

    def __call__(self, steps: int) -> None:
        """Takes steps in every environment."""
        world = self._env.unwrapped.world  # type: ignore[attr-defined]  # it is ours
        for _ in range(steps):
            self._driven += int(np.count_nonzero(world.driving))
            super().__call__(1)

    @property
    def driven(self) -> float:
        """Robots that drove in a step, of all environments together, in the mean so far."""
        return self._driven / self._tick


def env_step(*, quick: bool = False) -> list[Result]:
    """Measures the results whose names begin with ``world_``."""
    single_threaded()
    steps, blocks = (100, 3) if quick else (500, 15)
    scenario = Scenario.drawn(compose().env, 0)
    variants: dict[str, Callable[[int], object]] = {
        "world": Walk(scenario, 1),
        "cartpole": CartPole(),
        "batch": Walk(scenario, BATCH),
    }
    for variant in variants.values():
        variant(200 if quick else 2000)  # the projections that are met most are then remembered
    taken = take_turns(variants, steps, blocks)
    micros = {f"{name}_us": micro(seconds) for name, seconds in taken.items()}
    ratio = taken["world"] / taken["cartpole"]
    gain = BATCH * taken["world"] / taken["batch"]
    return [
        Result.over(
            "world_step_vs_cartpole_k3",
            ratio,
            "ratio",
            VS_CARTPOLE,
            Threshold(8, at_least=False),
            micros,
        ),
        Result.over(
            "world_batch_256_vs_1", gain, "ratio", BATCHED, Threshold(20, at_least=True), micros
        ),
        *_vectors(steps, blocks),
        *_maps(scenario.config, 100_000 * float(np.median(taken["cartpole"])), 3 if quick else 9),
    ]


def _vectors(steps: int, blocks: int) -> list[Result]:
    """The vector environment's robot steps a second, and over CartPole's steps a second."""
    robots, many, one = Robots(), Vector("CartPole-v1"), CartPole()
    for variant in (robots, many, one):
        variant(steps)
    taken = take_turns({"vector": robots, "cartpole_vector": many, "cartpole": one}, steps, blocks)
    driven = robots.driven
    robots_per_s = driven / taken["vector"]
    single_per_s, many_per_s = 1 / taken["cartpole"], BATCH / taken["cartpole_vector"]
    details = {
        "steps_per_s": BATCH / float(np.median(taken["vector"])),
        "robots_driving": driven,
        "cartpole_per_s": float(np.median(single_per_s)),
        "cartpole_vector_per_s": float(np.median(many_per_s)),
    }
    target = Threshold(300_000, at_least=True)
    name = "world_vector_robot_steps"
    return [
        Result.over(f"{name}_per_s", robots_per_s, "robot steps/s", VECTOR, target, details),
        Result.over(f"{name}_vs_cartpole_vector", robots_per_s / many_per_s, "ratio", VS_VECTOR),
        Result.over(f"{name}_vs_cartpole", robots_per_s / single_per_s, "ratio", VS_SINGLE),
    ]


def _maps(config: EnvConfig, unit_s: float, blocks: int) -> list[Result]:
    """The making of the largest radio maps, over a time in s."""
    largest = replace(config, ris=replace(config.ris, side=40, response="near"))
    beams = replace(largest, ris=replace(largest.ris, action="codebook"))
    makers = {
        "world_map_vs_100k_cartpole": lambda _: build_radio_map(largest),
        "world_map_codebook_vs_100k_cartpole": lambda _: build_radio_map(beams),
    }
    taken = take_turns(makers, 1, blocks)
    return [
        Result.over(name, taken[name] / unit_s, "ratio", what, Threshold(1, at_least=False))
        for name, what in zip(makers, (MAP, CODEBOOK), strict=True)
    ]
