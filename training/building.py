"""A building from the server's side, whatever the runtime: rooms play, and share what they learn.

Hierarchical federated averaging (Liu et al., 2020, "Client-edge-cloud hierarchical federated
learning"): inside a room robots' networks are averaged every N_F ticks, as Algorithm 1 says, and
across rooms every ``rooms.every`` such windows, which is a round.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agent import single_threaded
from conf import Config, ap_network, robot_network, taking_part
from conf.rooms import Room
from env.seeding import Stream, stream
from storage.checkpoint_files import digest
from training.checkpoint import Checkpoint, flat, part
from training.recording.progress import Progress
from training.recording.summary import FINAL_EPSILON, Accounts
from training.room_evaluation import RoomScore, RoomsEvaluator, overall, score
from training.room_recording import BuildingRecorder
from training.rooms import RoomHost, RoomReport, RoomTask, RoundTask, Weights, known_rooms
from training.run_folder import RunFolder


class BuildingRun:
    """One training run of a building; ``resumed`` is where it goes on, if it does not begin."""

    def __init__(
        self, config: Config, folder: RunFolder, resumed: Checkpoint | None = None
    ) -> None:
        from training.aggregation.strategies import build_aggregator  # Flower: once a run trains

        single_threaded()
        self._config, self._folder = config, folder
        self._accounts = Accounts(config, folder, resumed)
        folder.path.mkdir(parents=True, exist_ok=True)
        rooms = known_rooms(config, folder)
        self.rooms = [room for room in rooms if not room.held_out]
        self._held_out = [room for room in rooms if room.held_out]
        self._evaluator = RoomsEvaluator(config, rooms)
        marks = None if resumed is None else resumed.meta["marks"]
        self.recorder = BuildingRecorder(
            config, folder, self._evaluator, self._accounts.cpu_s, marks
        )
        count, self.progress = len(self.rooms), Progress()
        self._model = robot_network(rooms[0].config(config)).initial_pair(
            stream(config.seed, Stream.WEIGHTS, 0)
        )
        self._aps: dict[int, Weights] = {}
        self._played, self._ticks, self._episodes = np.zeros((3, count), np.int64)

        self._strategies: dict[str, Any] = {
            name: build_aggregator(config.rooms.strategy, count, who="room", partial=True)
            for name in ("robots", "ap")
        }
        self._shares_ap = config.rooms.access_points == "mean" and config.scheme.phase == "learned"
        if resumed is not None:
            self._restore(resumed)

    def train(self, host: RoomHost) -> dict[str, Any]:
        """Trains until the end of the round after the last tick, or as many episodes a room.

        Takes where the rooms live; returns what ``summary.json`` holds.
        """
        recorder, writer = self.recorder, self._accounts.writer
        self._accounts.runtime_costs = host.costs
        recorder.clients = host.clients
        recorder.on_start()
        try:
            stopped = False
            while not (stopped or self.progress.reaches(self._config.train)):
                stopped = self._play_round(host)
            writer.wait()
            trained_s = recorder.end_training()
            recorder.report("finishing", self.progress)
            summary = self._finish(trained_s, stopped=stopped)
            recorder.finish(summary)
            recorder.report("done", self.progress)
        finally:
            recorder.close()
            writer.close()
        return summary

    def _play_round(self, host: RoomHost) -> bool:
        """Plays a round; returns whether the run was asked to stop."""
        config, number = self._config, self.progress.window // self._config.rooms.every + 1
        self.recorder.round = number
        asked = self._drawn(number)
        tasks = [RoomTask(room, int(self._played[room.index]), self._given(room)) for room in asked]
        before = frozenset(np.flatnonzero(self._played).tolist())
        reports = host.play(RoundTask(number, self._model, host.forgets, tasks, before))
        came = sorted(reports)
        missing = [room.index for room in asked if room.index not in reports]
        self.progress.tick += config.rooms.every * config.federation.every
        self.progress.window += config.rooms.every
        for index in came:
            self._played[index], self._ticks[index] = number, reports[index].ticks
            self._episodes[index] += len(reports[index].episodes)
            if not self._shares_ap:
                self._aps[index] = reports[index].ap
        self.progress.episodes = int(self._episodes.sum()) // len(self.rooms)
        self.recorder.on_reports(self.progress, reports, missing)
        if came:
            self._share(number, [reports[index] for index in came])
        self.recorder.on_round(self.progress, self._model[0], self.ap_of)
        stopped = self._folder.stop_file.exists()
        over = stopped or self.progress.reaches(config.train)
        if config.state.every is not None and (host.forgets or over or self._is_due(number)):
            host.keep()
            self._checkpoint()
        return stopped

    def _drawn(self, number: int) -> Sequence[Room]:
        """The rooms that take part in a round, in order."""
        count = taking_part(self._config)
        if count == len(self.rooms):
            return self.rooms
        generator = stream(self._config.seed, Stream.PARTICIPATION, number)
        drawn = generator.choice(len(self.rooms), count, replace=False)
        return [self.rooms[index] for index in sorted(drawn)]

    def _given(self, room: Room) -> Weights | None:
        """The network that a room's access point takes at the beginning of a round."""
        if self._shares_ap and 0 in self._aps:
            return self._aps[0]
        return self._first_ap(room) if not self._played[room.index] else None

    def _first_ap(self, room: Room) -> Weights:
        """What access points start from: the same, where their networks have one size."""
        if self._config.scheme.phase != "learned":
            return np.zeros((2, 0), np.float32)
        return ap_network(room.config(self._config)).initial_pair(
            stream(self._config.seed, Stream.WEIGHTS, 1)
        )

    def _share(self, number: int, reports: Sequence[RoomReport]) -> None:
        """Averages across the rooms that have come, in the order of their indices."""
        uploads = np.stack([report.model for report in reports])
        self._model = self._strategies["robots"].aggregate(number, self._model, uploads)
        if self._shares_ap:
            aps = np.stack([report.ap for report in reports])
            before = self._aps.get(0, self._first_ap(self.rooms[0]))
            self._aps[0] = self._strategies["ap"].aggregate(number, before, aps)

    def ap_of(self, room: Room) -> Weights:
        """The online network of a room's access point, shape (P_AP,).

        With networks of their own, access points of rooms that have not played yet, and of those
        that are held out, have the one that all start from.
        """
        return np.asarray(self._ap_pair(room)[0])

    def _ap_pair(self, room: Room) -> Weights:
        """As ``ap_of``, online and target, shape (2, P_AP)."""
        own = None
        if self._shares_ap or not room.held_out:
            own = self._aps.get(0 if self._shares_ap else room.index)
        return self._first_ap(room) if own is None else own

    # --- Where it ends, and what it keeps ---------------------------------------------------------

    def _is_due(self, number: int) -> bool:
        """Whether a checkpoint is due in a round: its windows pass a multiple of ``every``."""
        every, windows = self._config.state.every, self._config.rooms.every
        return every is not None and number * windows // every > (number - 1) * windows // every

    def _checkpoint(self) -> None:
        """Writes the server's checkpoint of a round; those of all rooms are there."""
        run = {
            "progress": self.progress.counters(),
            "model": self._model,
            "played": self._played,
            "ticks": self._ticks,
            "episodes": self._episodes,
        }
        aps = {str(index): ap for index, ap in self._aps.items()}
        strategies = {f"strategy-{name}": s.state() for name, s in self._strategies.items()}
        arrays = flat({"run": run, "aps": aps, **strategies})
        copies = {name: np.array(array) for name, array in arrays.items()}
        self._accounts.checkpoint(self.progress.window, copies, self.recorder)
        self._accounts.writer.wait()  # or rooms could be ahead of it by more than one

    def _restore(self, resumed: Checkpoint) -> None:
        arrays, self.progress = resumed.arrays, resumed.progress
        run = part(arrays, "run")
        self._model = run["model"]
        self._played, self._ticks, self._episodes = (
            run[name].copy() for name in ("played", "ticks", "episodes")
        )
        self._aps = {int(index): ap for index, ap in part(arrays, "aps").items()}
        for name, strategy in self._strategies.items():
            strategy.restore(part(arrays, f"strategy-{name}"))

    def _finish(self, trained_s: float, *, stopped: bool) -> dict[str, Any]:
        """Evaluates the final weights in every room, and writes weights, summary and figures."""
        config, folder = self._config, self._folder
        scores: list[RoomScore] = []
        for room in (*self.rooms, *self._held_out):
            ap = self._ap_pair(room)
            scores.append(score(config, room, self._model[0], ap[0], FINAL_EPSILON))
            own, place = room.config(config), folder.room(room.name)
            place.path.mkdir(parents=True, exist_ok=True)
            place.write_config(own)
            robots = np.broadcast_to(self._model, (own.env.robots, *self._model.shape))
            place.write_weights(np.array(robots), ap, own)
        self.recorder.write_scores(self.progress, scores)
        aps = [np.zeros(0, np.float32), *(self._aps[i].ravel() for i in sorted(self._aps))]
        digests = {"robots": digest(self._model), "ap": digest(np.concatenate(aps))}
        kinds = {
            "trained_in": [each for each in scores if not each.room.held_out],
            "held_out": [each for each in scores if each.room.held_out],
        }
        scored = overall(kinds["trained_in"])
        summary = self._accounts.summary(
            self.recorder, self.progress, scored, digests, trained_s, stopped=stopped
        )
        summary["rooms"] = {
            "count": len(self.rooms),
            "robots": sum(room.config(config).env.robots for room in self.rooms),
            "ticks": self._ticks.tolist(),
            "episodes": self._episodes.tolist(),
            **{kind: overall(some)[1] for kind, some in kinds.items() if some},
        }
        folder.write_summary(summary)
        if config.run.figures:
            from training.recording.figures import save_rooms_figure  # matplotlib: where wanted

            save_rooms_figure(folder.figures / "rooms.png", self.recorder.rooms)
        return summary
