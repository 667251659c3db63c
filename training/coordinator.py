"""The coordinator: drives the access point, the world and the robots, tick by tick (Algorithm 1).

It knows no runtime. The robots are a ``Fleet``: calls within the process, or a link and Flower
messages; the order of events, and so every bit of every weight, is the same.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from conf import Config, robot_actions
from env.episode import EpisodeAccumulator
from env.world import StepResult, World
from lockstep import Expect, Fleet
from storage.generators import generator_state, restore_generator
from training.checkpoint import flat, part
from training.controllers.service import RisController
from training.exchange.facts import WindowFacts, plain
from training.partition import step_layout
from training.recording.progress import Observer, Progress
from training.step_records import StepRecords

if TYPE_CHECKING:
    from training.exchange.federation import Federation


class Coordinator:
    """One run of Algorithm 1.

    Args:
        config: the run's configuration.
        world: E worlds, in each of which all robots drive.
        ap: the controller of the RIS.
        fleet: the robots.
        federation: combines their weights, or None for independent learners.
        observer: receives episodes and windows.
        stop: called at every window boundary; True ends the run there.
        keep: callback after each aggregation window; receives ``is_last``.
    """

    def __init__(
        self,
        config: Config,
        world: World,
        ap: RisController,
        fleet: Fleet,
        federation: Federation | None,
        observer: Observer,
        stop: Callable[[], bool] = lambda: False,
        keep: Callable[[bool], None] = lambda final: None,
    ) -> None:
        self._config, self._records = config, StepRecords(step_layout(config), world)
        self._world, self._ap, self._fleet = world, ap, fleet
        self._federation, self._observer = federation, observer
        self._stop, self._keep = stop, keep
        self._actions = robot_actions(config)
        self._taken = np.zeros((world.robots, self._actions.count), np.int64)
        self._model: NDArray[np.float32] | None = None
        self._shared: NDArray[np.float32] = np.zeros((0, 2, 0), np.float32)
        self.progress = Progress()
        self.stopped = self._started = False
        self.waited_s = 0.0

    def run(
        self, initial: NDArray[np.float32], resumed: Mapping[str, NDArray[Any]] | None = None
    ) -> NDArray[np.float32]:
        """Trains until the window boundary after the last episode or tick.

        Args:
            initial: online and target weights that all robots hold at the run's very beginning,
                shape (2, P).
            resumed: the ``state`` that the run goes on from; the robots hold that window's.

        Returns:
            The robots' weights after the last aggregation, shape (K, 2, P).
        """
        model = self.begin(initial, resumed)
        if resumed is not None and self._is_over():  # it died after its last window
            return self._rows(model)
        return self.play(model)

    def begin(
        self, initial: NDArray[np.float32], resumed: Mapping[str, NDArray[Any]] | None = None
    ) -> NDArray[np.float32]:
        """Goes to where the run begins or goes on; arguments as ``run``.

        Returns:
            The model that robots hold there, shape (2, P), or each its own, (K, 2, P).
        """
        self._world.reset()
        self._tally = EpisodeAccumulator(self._world)
        if resumed is not None:
            self._restore(resumed)
        self._state = self._world.global_observation()
        return initial if self._model is None else self._model

    def play(self, model: NDArray[np.float32]) -> NDArray[np.float32]:
        """Plays windows until the run is over; may be called again to go on from there.

        Takes what all robots hold, shape (2, P), or each its own, (K, 2, P); returns the weights
        after the last aggregation, shape (K, 2, P).
        """
        final = self.stopped = False
        while not final:
            self.progress.window += 1
            window = self.progress.window
            final = self._play_window(window)
            uploads = self._fleet.upload(window)
            if self._federation is None:
                self._shared = plain(uploads)
            else:
                model, payload = self._federation.exchange(window, model, uploads, self._facts())
                self._hold(model)
                if not final:
                    self._fleet.download(window, payload)
            self._observer.on_window(self.progress, self._shared, self._ap.weights())
            self._keep(final)
        return self._rows(model)

    def _hold(self, model: NDArray[np.float32]) -> None:
        """Notes what robots hold: all the same, shape (2, P), or each its own, (K, 2, P)."""
        self._model = model
        self._shared = model if model.ndim == 3 else model[None]

    @property
    def shared(self) -> bool:
        """Whether all robots hold the same weights."""
        return len(self._shared) == 1

    def _facts(self) -> WindowFacts:
        """What the window has shown beside the weights; counting begins anew."""
        taken, self._taken = self._taken, np.zeros_like(self._taken)
        return WindowFacts(self._world.measured_db[0], taken)

    def _rows(self, model: NDArray[np.float32]) -> NDArray[np.float32]:
        """The robots' weights, shape (K, 2, P)."""
        return np.array(np.broadcast_to(self._shared, (self._world.robots, *model.shape[-2:])))

    def state(self) -> dict[str, NDArray[Any]]:
        """All of the server's side that the run needs to go on from a window boundary."""
        counters = self.progress.counters()
        run = {"progress": counters, "stream": generator_state(self._world.generator)}
        run |= {"robots": self._shared} if self._model is None else {"model": self._model}
        return flat(
            {
                "run": run,
                "world": self._world.state(),
                "tally": self._tally.state(),
                "ap": self._ap.state(),
                "federation": {} if self._federation is None else self._federation.state(),
            }
        )

    def _restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave."""
        run = part(state, "run")
        self.progress = Progress.of(run["progress"])
        if (model := run.get("model")) is None:
            self._shared = run["robots"]
        else:
            self._hold(model)
        restore_generator(self._world.generator, run["stream"])
        self._world.restore(part(state, "world"))
        self._tally.restore(part(state, "tally"))
        self._ap.restore(part(state, "ap"))
        if self._federation is not None:
            self._federation.restore(part(state, "federation"))

    def _play_window(self, window: int) -> bool:
        """Plays the ticks of a window; returns whether the run ends with it."""
        updates = self._records.of()
        self._records.observe_into(updates)
        self._fleet.send_step(self.progress.tick, window, Expect.ACTIONS, updates)
        if not self._started:
            self._observer.on_start()
            self._started = True
        for left in reversed(range(self._config.federation.every)):
            action = self._ap.act(self._state, self.progress.tick).astype(np.int64)
            direction, picks = self._robots_actions()
            phase, level = self._ap.serve(self._world, action, picks)
            outcome = self._world.step(phase, direction, level)
            self.progress.tick += 1
            expect = self._pass_on(window, action, outcome, last=left == 0)
        return expect is Expect.END_ROUND

    def _robots_actions(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Waits for the robots' actions, checked: directions and power picks, (E, K) each."""
        began = time.perf_counter()
        chosen = self._fleet.actions(self.progress.tick).astype(np.int64)
        self.waited_s += time.perf_counter() - began
        most, worlds = self._actions.count - 1, len(self._world.cell)
        wrong = np.flatnonzero((chosen < -1) | (chosen > most))
        if len(wrong):
            robot, action = wrong[0] // worlds, chosen[wrong[0]]
            raise ValueError(
                f"tick {self.progress.tick}: action {action} of robot {robot}, of -1 to {most}"
            )
        chosen = chosen.reshape(-1, worlds)
        if self._federation is not None:
            robots, _ = drives = np.nonzero(chosen >= 0)
            np.add.at(self._taken, (robots, chosen[drives]), 1)
        return self._actions.decode(chosen.T)

    def _pass_on(
        self, window: int, action: NDArray[np.int64], outcome: StepResult, *, last: bool
    ) -> Expect:
        """Sends robots their results, while they learn the AP does; returns what they answer."""
        updates, state = self._records.of(outcome), self._state
        ended, seen = outcome.terminated | outcome.truncated, None
        ends = bool(ended.any())
        if ends:  # what is counted and seen of an episode comes before the next one begins
            seen = self._count(outcome)
            self._end_episodes(ended)
        self._records.observe_into(updates, anew=ends)
        if self._federation is not None:
            self._federation.observed(updates)
        expect = Expect.ACTIONS
        if last:
            expect = Expect.END_ROUND if self._is_over() else Expect.WEIGHTS
        self._fleet.send_step(self.progress.tick, window, expect, updates)
        if seen is None:
            seen = self._count(outcome)
        self._state = self._world.global_observation() if ends else seen
        self._ap.learn(state, action, outcome, seen)
        return expect

    def _count(self, outcome: StepResult) -> NDArray[np.float32]:
        """Adds a step to the episode; returns the access point's next state."""
        self._tally.add(outcome)
        return self._world.global_observation()

    def _end_episodes(self, ended: NDArray[np.bool_]) -> None:
        """Begins the next episodes of some worlds, shape (E,), each of which counts by itself."""
        measures = self._tally.measures()
        for world in np.flatnonzero(ended):
            self.progress.episodes += 1
            self._observer.on_episode(self.progress, measures.of(slice(world, world + 1)))
        self._world.restart(ended)
        self._tally.restart(ended)

    def _is_over(self) -> bool:
        self.stopped |= self._stop()
        return self.stopped or self.progress.reaches(self._config.train)
