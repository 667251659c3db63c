"""A run in this process that can be taken step by step: the local runtime without its files."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from client_app.robots import RobotGroup
from conf import Config, compose, robot_network, robots_learn
from env.episode import EpisodeMeasures
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World
from lockstep import Fleet, InProcessFleet
from training.controllers.access_point import AccessPoint
from training.controllers.central import CentralAgent
from training.controllers.schemes import build_central
from training.coordinator import Coordinator
from training.exchange.federation import build_federation
from training.recording.progress import Progress

OVERRIDES = (
    "runtime=local",
    "agent.epsilon.start=0.05",  # as late in a run: nearly every action needs a forward pass
    "train.episodes=1000000000",
)


class Unwatched:
    """An observer of a run that does nothing."""

    def on_start(self) -> None:
        """The first tick begins."""

    def on_episode(self, progress: Progress, measures: EpisodeMeasures) -> None:
        """An episode has ended."""

    def on_window(
        self, progress: Progress, robots: NDArray[np.float32], ap: NDArray[np.float32]
    ) -> None:
        """A window has ended."""


def configured(*overrides: str) -> Config:
    """The default configuration as a run late in training has it, with overrides."""
    return compose([*OVERRIDES, *overrides])


def initial_weights(config: Config) -> NDArray[np.float32]:
    """The network that all robots start from, shape (2, P); P is 0 where they have none."""
    if not robots_learn(config):
        return np.zeros((2, 0), np.float32)
    return robot_network(config).initial_pair(stream(config.seed, Stream.WEIGHTS))


class ServerSide:
    """World, access point and coordinator, to be driven in stretches.

    Every stretch is a `Coordinator.run` of its own on the same world, agent and fleet.

    Args:
        config: of the run.
        fleet: the robots.
        keep: called with the run at every window boundary of a stretch.
        agent: one for everything, in the place of an access point, if there is one.
    """

    def __init__(
        self,
        config: Config,
        fleet: Fleet,
        keep: Callable[[Coordinator], None] = lambda run: None,
        agent: CentralAgent | None = None,
    ) -> None:
        self._config, self._fleet, self._keep = config, fleet, keep
        scenario = Scenario.drawn(config.env, config.seed)
        self.world = World(scenario, stream(config.seed, Stream.WORLD))
        self.ap = agent or AccessPoint(config)
        self._model = initial_weights(config)
        self.waited_s = 0.0

    def play(self, steps: int) -> None:
        """Takes joint steps, up to the end of a window."""
        train = dataclasses.replace(self._config.train, max_ticks=steps)
        config = dataclasses.replace(self._config, train=train)
        federation = build_federation(config)
        run = Coordinator(
            config,
            self.world,
            self.ap,
            self._fleet,
            federation,
            Unwatched(),
            keep=lambda final: self._keep(run),
        )
        self._model = run.run(self._model)[0]
        self.waited_s += run.waited_s


class LocalRun(ServerSide):
    """All agents in this process.

    Attributes:
        group: the robots.
    """

    def __init__(self, config: Config) -> None:
        self.group = RobotGroup(config, range(config.env.robots))
        self.group.download(0, initial_weights(config))
        super().__init__(config, InProcessFleet([(self.group.robots, self.group)]))

    def play(self, steps: int) -> None:
        """See ``ServerSide.play``; each stretch is a conversation of its own."""
        self._fleet = InProcessFleet([(self.group.robots, self.group)])
        super().play(steps)


class CentralRun(ServerSide):
    """One agent for everything, and robots that wait for its orders."""

    def __init__(self, config: Config) -> None:
        agent = build_central(config)
        super().__init__(config, agent.fleet, agent=agent)
