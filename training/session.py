"""A run from the server's side, whatever the runtime: everything but where the robots are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from agent import single_threaded
from conf import Config, robot_network, robots_learn
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World
from lockstep import Fleet
from storage.checkpoint_files import digest
from training.checkpoint import Checkpoint
from training.communication import per_tick, waiting
from training.controllers.schemes import build_ris_controller
from training.coordinator import Coordinator
from training.evaluation import Evaluator
from training.exchange.airtime import Airtime
from training.recording.costs import Costs
from training.recording.history import evaluate
from training.recording.recorder import Recorder
from training.recording.summary import FINAL_EPSILON, Accounts
from training.run_folder import RunFolder

if TYPE_CHECKING:
    from training.exchange.federation import Federation


class TrainingRun:
    """One training run.

    Args:
        config: the run's configuration.
        folder: the run's folder.
        resumed: where the run goes on, if it does not begin.
        losses: what was lost on the way here, for the summary.
    """

    def __init__(
        self,
        config: Config,
        folder: RunFolder,
        resumed: Checkpoint | None = None,
        losses: Sequence[dict[str, Any]] = (),
    ) -> None:
        single_threaded()
        self.config, self.folder, self._resumed = config, folder, resumed
        self._accounts = Accounts(config, folder, resumed)
        scenario = Scenario.drawn(config.env, config.seed)
        self.world = World(scenario, stream(config.seed, Stream.WORLD), config.train.worlds)
        self.ap = build_ris_controller(config, self.world)
        self.evaluator = Evaluator(config, scenario)
        marks = None if resumed is None else resumed.meta["marks"]
        self.recorder = Recorder(config, folder, self.evaluator, self._accounts.cpu_s, marks)
        self.recorder.losses = list(losses)

    def initial_weights(self) -> NDArray[np.float32]:
        """The network that all robots start from, online and target, shape (2, P); P may be 0."""
        if not robots_learn(self.config):
            return np.zeros((2, 0), np.float32)
        return robot_network(self.config).initial_pair(stream(self.config.seed, Stream.WEIGHTS))

    def train(
        self,
        fleet: Fleet,
        costs: Callable[[], Costs] = Costs,
        clients: Callable[[], list[dict[str, Any]]] = list,
    ) -> dict[str, Any]:
        """Trains with a fleet and writes everything that the run leaves behind.

        Args:
            fleet: the robots, which are sent to where the run begins or goes on.
            costs: what the runtime has added since this process began.
            clients: each client: its robots, and what it has cost.

        Returns:
            What ``summary.json`` holds.
        """
        from training.exchange.federation import build_federation  # Flower: once a run trains

        try:
            federation = build_federation(self.config)
        except BaseException:
            self.recorder.close()
            raise
        earlier = costs()  # of a part of the run that was played in vain
        self._accounts.runtime_costs = lambda: costs().minus(earlier)
        self.recorder.clients = clients

        def keep(last: bool) -> None:
            every, window = self.config.state.every, run.progress.window
            if every is not None and (last or window % every == 0):
                self._accounts.checkpoint(window, run.state(), self.recorder, waited_s=run.waited_s)

        run = Coordinator(
            self.config,
            self.world,
            self.ap,
            fleet,
            federation,
            self.recorder,
            self.folder.stop_file.exists,
            keep,
        )
        initial, resumed, writer = self.initial_weights(), self._resumed, self._accounts.writer
        try:
            if resumed is None:
                fleet.begin(0, initial)
                robots = run.run(initial)
            else:
                run.waited_s = resumed.meta["spent"]["waited_s"]
                fleet.begin(resumed.window, resumed.model)
                robots = run.run(initial, resumed.arrays)
            writer.wait()
            if not self.recorder.running:
                self.recorder.on_start()
            trained_s = self.recorder.end_training()
            self.recorder.report("finishing", run.progress)
            summary = self._finish(run, robots, trained_s, federation)
            self.recorder.finish(summary)
            self.recorder.report("done", run.progress)
        except BaseException:
            with suppress(OSError):  # of a full disk: the error that stands is the first
                self.recorder.report("training", run.progress)
            raise
        finally:
            self.recorder.close()
            writer.close()
        return summary

    def _finish(
        self,
        run: Coordinator,
        robots: NDArray[np.float32],
        trained_s: float,
        federation: Federation | None,
    ) -> dict[str, Any]:
        """Evaluates the final weights, and writes weights, summary and figures."""
        ap, config = self.ap.weights(), self.config
        self.folder.write_weights(robots, ap, config)
        online = robots[:1, 0] if run.shared else robots[:, 0]
        found = evaluate(self.evaluator, online, ap[0], FINAL_EPSILON)
        self.recorder.show_episode(self.folder, run.progress, found.episode)
        scores, digests = (
            (found.explored, found.greedy),
            {"robots": digest(robots), "ap": digest(ap)},
        )
        summary = self._accounts.summary(
            self.recorder, run.progress, scores, digests, trained_s, stopped=run.stopped
        )
        summary |= {
            "waited_s": run.waited_s,
            "communication": {
                **(per_tick(config) if robots_learn(config) else {}),
                "waiting": waiting(summary["clients"]),
            },
            "uploads": None if federation is None else federation.uploads(),
            "arrivals": found.arrivals.tolist(),
        }
        airtime = Airtime(config) if robots_learn(config) else None
        if federation is not None:
            airtime = federation.airtime
        if airtime is not None:
            summary["airtime"] = airtime.summary(summary["evaluation"]["last5"])
        self.folder.write_summary(summary)
        if config.run.figures:
            from training.recording.figures import save_figures  # matplotlib: where it is wanted

            history = self.recorder.history
            save_figures(self.folder.figures, config, self.evaluator, online, ap[0], history)
        return summary
