"""The coordinator: drives the access point, the world and the robots, tick by tick (Algorithm 1).

It knows no runtime. The robots are a ``Fleet``: calls within the process, or a link and Flower
messages; the order of events, and so every bit of every weight, is the same.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from conf import Config
from env import actions
from env.link import UPDATE, Flag, Fleet, Want
from env.tally import EpisodeMeasures, EpisodeTally
from env.world import Outcome, World
from server_app.access_point import AccessPoint
from server_app.aggregation import Aggregator


@dataclass
class Progress:
    """Where a run is: counters that belong to its state.

    Attributes:
        tick: joint steps taken.
        window: aggregations made.
        episodes: training episodes that have ended.
    """

    tick: int = 0
    window: int = 0
    episodes: int = 0


class Observer(Protocol):
    """Whoever watches a run."""

    def on_start(self) -> None:
        """Every robot has joined and the first tick begins."""
        ...

    def on_episode(self, progress: Progress, measures: EpisodeMeasures) -> None:
        """A training episode has ended."""
        ...

    def on_window(
        self, progress: Progress, robots: NDArray[np.float32], ap: NDArray[np.float32]
    ) -> None:
        """Weights after aggregation: robots (K, 2, P), or (1, 2, P) if all are the same."""
        ...


class Coordinator:
    """One run.

    Args:
        config: the run's configuration.
        world: a single world.
        ap: the access point's agent.
        fleet: the robots.
        aggregator: the strategy, or None for independent learners.
        observer: told of episodes and windows.
        stop: asked at every window boundary whether to end the run there.
    """

    def __init__(
        self,
        config: Config,
        world: World,
        ap: AccessPoint,
        fleet: Fleet,
        aggregator: Aggregator | None,
        observer: Observer,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self._config = config
        self._world, self._ap, self._fleet = world, ap, fleet
        self._aggregator = aggregator
        self._observer = observer
        self._stop = stop
        self._levels = config.env.power.levels
        self.progress = Progress()
        self.stopped = False
        self.waited_s = 0.0

    def run(self, initial: NDArray[np.float32]) -> NDArray[np.float32]:
        """Trains until the window boundary after the last episode or tick.

        Args:
            initial: online and target weights that all robots hold now, shape (2, P).

        Returns:
            The robots' weights after the last aggregation, shape (K, 2, P).
        """
        model, final = initial, False
        self._world.reset()
        self._tally = EpisodeTally(self._world)
        robots = np.repeat(model[None], self._world.robots, axis=0)
        while not final:
            self.progress.window += 1
            window = self.progress.window
            final = self._play_window(window)
            uploads = self._fleet.upload(window)
            if self._aggregator is None:
                robots = shared = uploads
            else:
                model = self._aggregator.aggregate(window, model, uploads)
                shared = model[None]
                robots = np.repeat(shared, self._world.robots, axis=0)
                if not final:
                    self._fleet.download(window, model)
            self._observer.on_window(self.progress, shared, self._ap.weights())
        return robots

    def _play_window(self, window: int) -> bool:
        """Plays the ticks of a window; returns whether the run ends with it."""
        ticks = self._config.federation.every
        world, fleet, ap = self._world, self._fleet, self._ap
        local = world.local_observations()
        state = world.global_observation(local)
        fleet.tell(self.progress.tick, window, Want.ACTIONS, self._updates())
        want = Want.ACTIONS
        for left in reversed(range(ticks)):
            if self.progress.tick == 0:
                self._observer.on_start()
            phase = ap.act(state, self.progress.tick)
            began = time.perf_counter()
            chosen = fleet.actions(self.progress.tick).astype(np.int64)
            self.waited_s += time.perf_counter() - began
            outcome = world.step(phase, *actions.decode(chosen[None], self._levels))
            self.progress.tick += 1
            updates = self._updates(outcome)
            following = world.global_observation()
            terminal = outcome.terminated
            self._tally.add(outcome)
            if outcome.terminated[0] or outcome.truncated[0]:
                self._end_episode()
                state_next = world.global_observation()
            else:
                state_next = following
            if left == 0:
                want = Want.FAREWELL if self._is_over() else Want.WEIGHTS
            self._observe_into(updates)
            fleet.tell(self.progress.tick, window, want, updates)
            ap.learn(state, phase, outcome.global_reward, following, terminal)
            state = state_next
        return want is Want.FAREWELL

    def _end_episode(self) -> None:
        self.progress.episodes += 1
        self._observer.on_episode(self.progress, self._tally.measures())
        self._world.reset()
        self._tally = EpisodeTally(self._world)

    def _is_over(self) -> bool:
        train = self._config.train
        if self._stop():
            self.stopped = True
        enough = self.progress.episodes >= train.episodes
        late = train.max_ticks is not None and self.progress.tick >= train.max_ticks
        return enough or late or self.stopped

    def _updates(self, outcome: Outcome | None = None) -> np.ndarray:
        """The robots' records: what an outcome told them, if there is one; else a first sight."""
        world = self._world
        updates = np.zeros(world.robots, dtype=UPDATE)
        if outcome is None:
            self._observe_into(updates)
            return updates
        updates["flags"] = outcome.drove[0] * Flag.OUTCOME.value
        updates["flags"] |= outcome.arrived[0] * np.uint16(Flag.ARRIVED)
        updates["outcome_cell"] = world.cell[0]
        updates["outcome_channel_db"] = world.radio_map.direct_db[world.cell[0]]
        updates["rate"] = outcome.rate[0]
        return updates

    def _observe_into(self, updates: np.ndarray) -> None:
        """Adds what each robot observes now, after a reset where an episode has just ended."""
        world = self._world
        updates["flags"] |= world.driving[0] * np.uint16(Flag.DRIVING)
        updates["cell"] = world.cell[0]
        updates["channel_db"] = world.radio_map.direct_db[world.cell[0]]
