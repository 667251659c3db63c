"""Playing frozen weights: how good a policy is, apart from how it learns."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from conf import Config
from env.episode import EpisodeAccumulator, EpisodeMeasures
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World
from training.controllers.policies import Exploration, Policy, PolicyWeights, frozen_policy
from training.controllers.service import Served


class Evaluator:
    """Held-out episodes of a run, stepped together as one batch.

    Starts, exploration and, where each slot has its own, fading come from the evaluation stream,
    from its beginning at every call: all evaluations of a seed play the same starts, whatever else
    they play.

    Args:
        config: the run's configuration.
        scenario: the run's, to share; made if None.
        episodes: how many; ``config.evaluation.episodes`` if None.
        starts_seed: seed of the evaluation stream, the run's if None; destinations stay the run's.
        policy: who decides, what the run's scheme says if None.

    Attributes:
        world: the world that is played in.
        starts: the cells of the held-out starts, shape (episodes, K).
    """

    def __init__(
        self,
        config: Config,
        scenario: Scenario | None = None,
        episodes: int | None = None,
        starts_seed: int | None = None,
        policy: Policy | None = None,
    ) -> None:
        self.config = config
        self.episodes = episodes or config.evaluation.episodes
        self._seed = config.seed if starts_seed is None else starts_seed
        scenario = scenario or Scenario.drawn(config.env, config.seed)
        self.world = World(scenario, stream(self._seed, Stream.EVALUATION), self.episodes)
        self.starts = self.world.draw_starts(self.episodes)
        self._policy = policy or frozen_policy(config, self.world)

    def play(
        self,
        robots: NDArray[np.float32],
        ap: NDArray[np.float32],
        epsilons: Sequence[float],
        serve: Callable[[World, Served], Served] | None = None,
    ) -> list[EpisodeMeasures]:
        """Plays the episodes to their end, once with each epsilon.

        Args:
            robots: online weights of each robot, shape (K, P), or of all, shape (1, P).
            ap: online weights of the access point, shape (P_AP,).
            epsilons: probabilities of a random action, for every agent that learns.
            serve: is shown every slot of the len(epsilons) * episodes worlds, and may replace the
                agents' phases and power levels, if given; motion stays theirs, since no agent
                observes the phase or powers.

        Returns:
            The measures for each epsilon.
        """
        world = self.world
        fading = [stream(self._seed, Stream.EVALUATION, 2) for _ in epsilons]
        world.reset(np.concatenate([self.starts] * len(epsilons)), fading)
        tally = EpisodeAccumulator(world)
        exploration = Exploration(self._seed, epsilons, self.episodes)
        weights = PolicyWeights(robots, ap)
        for _ in range(world.config.motion.max_slots):
            phase, direction, level = self._policy(world, weights, exploration)
            if serve is not None:
                phase, level = serve(world, (phase, level))
            outcome = world.step(phase, direction, level)
            tally.add(outcome)
            if outcome.terminated.all():
                break
        measures = tally.measures()
        blocks = range(0, len(epsilons) * self.episodes, self.episodes)
        return [measures.of(slice(first, first + self.episodes)) for first in blocks]
