"""A run from the server's side, whatever the runtime: everything but where the robots are."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from agent import single_threaded
from conf import Config, fingerprint, robot_network, robots_learn
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World
from lockstep import Fleet
from storage.checkpoint_files import Writer, digest
from storage.checkpoint_layout import owner
from training.checkpoint import Checkpoint, save_server
from training.communication import per_tick, waiting
from training.controllers.schemes import build_ris_controller
from training.coordinator import Coordinator
from training.evaluation import Evaluator
from training.exchange.airtime import Airtime
from training.recording.costs import Costs
from training.recording.history import evaluate
from training.recording.recorder import Recorder
from training.recording.summary import summarise
from training.run_folder import RunFolder

if TYPE_CHECKING:
    from training.exchange.federation import Federation

FINAL_EPSILON = 0.05


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
        self.losses = list(losses)
        self.config, self.folder, self._resumed = config, folder, resumed
        spent = {"wall_s": 0.0, "cpu_s": 0.0, "waited_s": 0.0}
        if resumed is not None:
            spent = resumed.meta["spent"]
        self._waited_s = spent["waited_s"]
        self._costs: Callable[[], Costs] = Costs
        self._writer = Writer()
        self._airtime = Airtime(config) if robots_learn(config) else None
        self._began = time.perf_counter() - spent["wall_s"]
        self._cpu_before = time.process_time() - spent["cpu_s"]
        scenario = Scenario.drawn(config.env, config.seed)
        self.world = World(scenario, stream(config.seed, Stream.WORLD), config.train.worlds)
        self.ap = build_ris_controller(config, self.world)
        self.evaluator = Evaluator(config, scenario)
        marks = None if resumed is None else resumed.meta["marks"]
        self.recorder = Recorder(config, folder, self.evaluator, self.cpu_s, marks)
        self.recorder.losses = self.losses

    def cpu_s(self) -> float:
        """Processor time of this process and of the robots' processes since the run began."""
        return time.process_time() - self._cpu_before + self._costs().client_cpu_s

    def initial_weights(self) -> NDArray[np.float32]:
        """The network that all robots start from, online and target, shape (2, P); P may be 0."""
        if not robots_learn(self.config):
            return np.zeros((2, 0), np.float32)
        return robot_network(self.config).initial_pair(stream(self.config.seed, Stream.WEIGHTS))

    def model(self) -> NDArray[np.float32] | None:
        """What all robots take before the first tick, shape (2, P); None if they hold it."""
        return self.initial_weights() if self._resumed is None else self._resumed.model

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
        if federation is not None:
            self._airtime = federation.airtime
        before = Costs() if self._resumed is None else Costs(**self._resumed.meta["costs"])
        earlier = costs()  # of a part of the run that was played in vain
        self._costs = lambda: before.plus(costs().minus(earlier))
        self.recorder.clients = clients
        stop = self.folder.stop_file.exists

        def keep(last: bool) -> None:
            self._checkpoint(run, last=last)

        run = Coordinator(
            self.config, self.world, self.ap, fleet, federation, self.recorder, stop, keep
        )
        run.waited_s = self._waited_s
        resumed = self._resumed
        try:
            fleet.begin(0 if resumed is None else resumed.window, self.model())
            arrays = None if resumed is None else resumed.arrays
            robots = run.run(self.initial_weights(), arrays)
            self._writer.wait()
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
            self._writer.close()
        return summary

    def _checkpoint(self, run: Coordinator, *, last: bool) -> None:
        """Writes the server's checkpoint of a window, where it is due or the run's last."""
        every, window = self.config.state.every, run.progress.window
        if every is None or (window % every and not last):
            return
        spent = {
            "wall_s": time.perf_counter() - self._began,
            "cpu_s": time.process_time() - self._cpu_before,
            "waited_s": run.waited_s,
        }
        meta = {
            **owner(self.config.run.id),
            "spent": spent,
            "costs": asdict(self._costs()),
            "marks": self.recorder.marks(),
            "fingerprint": fingerprint(self.config.env),
            "losses": self.losses,
        }
        save_server(self._writer, self.folder.state, window, run.state(), meta)
        self.recorder.checkpoint = window

    def _finish(
        self,
        run: Coordinator,
        robots: NDArray[np.float32],
        trained_s: float,
        federation: Federation | None,
    ) -> dict[str, Any]:
        """Evaluates the final weights, and writes weights, summary and figures."""
        ap = self.ap.weights()
        self.folder.write_weights(robots, ap, self.config)
        online = robots[:1, 0] if run.shared else robots[:, 0]
        found = evaluate(self.evaluator, online, ap[0], FINAL_EPSILON)
        self.recorder.show_episode(self.folder, run.progress, found.episode)
        history = self.recorder.history
        costs = self._costs()
        summary = summarise(
            self.config,
            self.recorder,
            run.progress,
            (found.explored, found.greedy),
            {"robots": digest(robots), "ap": digest(ap)},
            costs,
            trained_s,
        ) | {
            "stopped_early": run.stopped,
            "wall_s": time.perf_counter() - self._began,
            "waited_s": run.waited_s,
            "cpu_s": self.cpu_s(),
            "clients": (clients := self.recorder.clients()),
            "communication": {
                **(per_tick(self.config) if robots_learn(self.config) else {}),
                "waiting": waiting(clients),
            },
            "losses": self.losses,
            "uploads": None if federation is None else federation.uploads(),
            "arrivals": found.arrivals.tolist(),
        }
        if self._airtime is not None:
            summary["airtime"] = self._airtime.summary(summary["evaluation"]["last5"])
        self.folder.write_summary(summary)
        if self.config.run.figures:
            from training.recording.figures import save_figures  # matplotlib: where it is wanted

            save_figures(self.folder.figures, self.config, self.evaluator, online, ap[0], history)
        return summary
