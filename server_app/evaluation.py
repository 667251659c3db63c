"""Playing frozen weights: how good a policy is, apart from how it learns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent import q_values
from conf import Config, ap_network, robot_network
from env import actions
from env.floor import Floor
from env.radio_map import RadioMap
from env.seeding import Stream, stream
from env.tally import EpisodeMeasures, EpisodeTally
from env.world import World, draw_destinations


class Evaluator:
    """Held-out episodes of a run, stepped together as one batch.

    Starts and exploration come from the evaluation stream, from its beginning at every call: all
    evaluations of a seed play the same starts.

    Args:
        config: the run's configuration.
        radio_map: tables to share; built if None.
        episodes: how many; ``config.evaluation.episodes`` if None.
    """

    def __init__(
        self,
        config: Config,
        radio_map: RadioMap | None = None,
        episodes: int | None = None,
    ) -> None:
        self._seed = config.seed
        self._levels = config.env.power.levels
        self._robot, self._ap = robot_network(config), ap_network(config)
        destinations = draw_destinations(config.env, stream(config.seed, Stream.DESTINATIONS))
        generator = stream(config.seed, Stream.EVALUATION)
        self.world = World(
            config.env, destinations, generator, episodes or config.evaluation.episodes, radio_map
        )

    def play(
        self,
        robots: NDArray[np.float32],
        ap: NDArray[np.float32],
        epsilon: float,
        trace: list[NDArray[np.int64]] | None = None,
    ) -> EpisodeMeasures:
        """Plays all episodes to their end.

        Args:
            robots: online weights of each robot, shape (K, P), or of all, shape (1, P).
            ap: online weights of the access point, shape (P_AP,).
            epsilon: probability of a random action, for every agent.
            trace: takes the cells (B, K) of every slot, the start first, if given.

        Returns:
            The measures of the episodes.
        """
        world = self.world
        world.generator = stream(self._seed, Stream.EVALUATION)
        world.reset()
        tally = EpisodeTally(world)
        if trace is not None:
            trace.append(world.cell)
        for _ in range(world.config.motion.max_slots):
            local = world.local_observations()
            phase = self._phase(world.global_observation(local), ap, epsilon)
            action = self._actions(local, robots, epsilon)
            outcome = world.step(phase, *actions.decode(action, self._levels))
            tally.add(outcome)
            if trace is not None:
                trace.append(world.cell)
            if outcome.terminated.all():
                break
        return tally.measures()

    def _actions(
        self, local: NDArray[np.float32], robots: NDArray[np.float32], epsilon: float
    ) -> NDArray[np.int64]:
        """The robots' actions, shape (B, K)."""
        worlds, count, size = local.shape
        if len(robots) == 1:
            values = q_values(self._robot, robots, local.reshape(1, worlds * count, size))
            greedy = values.argmax(axis=-1).reshape(worlds, count)
        else:
            by_robot = np.ascontiguousarray(local.transpose(1, 0, 2))
            greedy = q_values(self._robot, robots, by_robot).argmax(axis=-1).T
        return self._explore(greedy, epsilon, self._robot.actions)

    def _phase(
        self, state: NDArray[np.float32], ap: NDArray[np.float32], epsilon: float
    ) -> NDArray[np.int64]:
        greedy = q_values(self._ap, ap[None], state[None]).argmax(axis=-1)[0]
        return self._explore(greedy, epsilon, self._ap.actions)

    def _explore(
        self, greedy: NDArray[np.int64], epsilon: float, count: int
    ) -> NDArray[np.int64]:
        if epsilon == 0:
            return greedy
        generator = self.world.generator
        random = generator.integers(count, size=greedy.shape)
        return np.where(generator.random(greedy.shape) < epsilon, random, greedy)


def trajectories(trace: list[NDArray[np.int64]], floor: Floor) -> NDArray[np.float64]:
    """Positions in m of a traced episode, shape (slots + 1, B, K, 2)."""
    return floor.centres()[np.stack(trace)]
