"""The stacked engine against four reference learners: three robots and the access point."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from agent import DQN, NetworkShape, single_threaded
from agent.reference import ReferenceDQN
from benchmarks.result import Result, Threshold, micro, take_turns
from conf import Config, ap_network, compose, robot_network
from env.seeding import Stream, stream

WIDTHS = {64: Threshold(2.5, at_least=True), 128: Threshold(2.0, at_least=True)}
EPSILON = 0.05
RECORDED = 512
HOW = (
    "joint steps (act, store, learn) per processor second of agent.DQN, 3 robots stacked and the"
    " AP, over those of four agent.reference.ReferenceDQN; one thread, blocks in turn"
)


class Experience:
    """The same made-up transitions for every engine."""

    def __init__(self, robot: NetworkShape, ap: NetworkShape, robots: int) -> None:
        rng = np.random.default_rng(0)
        self.robot = rng.normal(size=(RECORDED + 1, robots, robot.inputs)).astype(np.float32)
        self.ap = rng.normal(size=(RECORDED + 1, 1, ap.inputs)).astype(np.float32)
        self.robot_reward = rng.normal(size=(RECORDED, robots))
        self.ap_reward = rng.normal(size=(RECORDED, 1))


class Stacked:
    """The engine: the robots in one stack and the access point in another."""

    def __init__(self, config: Config, experience: Experience) -> None:
        robots = experience.robot.shape[1]
        self._experience, self._tick = experience, 0
        robot, ap = robot_network(config), ap_network(config)
        streams = [stream(0, Stream.ROBOT, k) for k in range(robots)]
        discount = config.agent.discount
        self._robots = DQN(robot, config.agent, discount.robot, streams)
        self._ap = DQN(ap, config.agent, discount.ap, [stream(0, Stream.AP)])
        for agents in (self._robots, self._ap):
            agents.load(agents.shape.initial_pair(stream(0, Stream.WEIGHTS)))
        self._active = np.ones(robots, dtype=bool)
        self._ended = np.zeros(robots, dtype=bool)

    def __call__(self, steps: int) -> None:
        """Takes joint steps."""
        seen, active, ended = self._experience, self._active, self._ended
        for _ in range(steps):
            at = self._tick % RECORDED
            self._tick += 1
            moves = self._robots.act(seen.robot[at], EPSILON, active)
            phase = self._ap.act(seen.ap[at], EPSILON, active[:1])
            reward, next_observation = seen.robot_reward[at], seen.robot[at + 1]
            self._robots.learn(seen.robot[at], moves, reward, next_observation, ended, active)
            reward, next_observation = seen.ap_reward[at], seen.ap[at + 1]
            self._ap.learn(seen.ap[at], phase, reward, next_observation, ended[:1], active[:1])


class Plain:
    """Four reference learners, one after the other."""

    def __init__(self, config: Config, experience: Experience) -> None:
        robots = experience.robot.shape[1]
        self._experience, self._tick = experience, 0
        robot, ap = robot_network(config), ap_network(config)
        discount, first = config.agent.discount, stream(0, Stream.WEIGHTS)
        self._robots = [
            ReferenceDQN(
                robot,
                config.agent,
                discount.robot,
                stream(0, Stream.ROBOT, k),
                robot.initial_weights(first),
            )
            for k in range(robots)
        ]
        self._ap = ReferenceDQN(
            ap, config.agent, discount.ap, stream(0, Stream.AP), ap.initial_weights(first)
        )

    def __call__(self, steps: int) -> None:
        """Takes joint steps."""
        seen = self._experience
        for _ in range(steps):
            at = self._tick % RECORDED
            self._tick += 1
            moves = [a.act(seen.robot[at, k], EPSILON) for k, a in enumerate(self._robots)]
            phase = self._ap.act(seen.ap[at, 0], EPSILON)
            for k, agent in enumerate(self._robots):
                reward, next_observation = float(seen.robot_reward[at, k]), seen.robot[at + 1, k]
                agent.learn(seen.robot[at, k], moves[k], reward, next_observation, False)
            reward, next_observation = float(seen.ap_reward[at, 0]), seen.ap[at + 1, 0]
            self._ap.learn(seen.ap[at, 0], phase, reward, next_observation, False)


def engine(*, quick: bool = False) -> list[Result]:
    """Measures ``engine_vs_four_learners_h64`` and ``..._h128``."""
    single_threaded()
    steps, blocks = (20, 2) if quick else (60, 15)
    return [_compared(width, target, steps, blocks) for width, target in WIDTHS.items()]


def _compared(width: int, target: Threshold, steps: int, blocks: int) -> Result:
    config = compose([f"agent.hidden=[{width},{width}]"])
    experience = Experience(robot_network(config), ap_network(config), config.env.robots)
    variants: dict[str, Callable[[int], object]] = {
        "plain": Plain(config, experience),
        "stacked": Stacked(config, experience),
    }
    for variant in variants.values():
        variant(config.agent.learn_from + steps)
    taken = take_turns(variants, steps, blocks)
    return Result.over(
        f"engine_vs_four_learners_h{width}",
        taken["plain"] / taken["stacked"],
        "ratio",
        HOW,
        target,
        {f"{name}_us_per_joint_step": micro(seconds) for name, seconds in taken.items()},
    )
