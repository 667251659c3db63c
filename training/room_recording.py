"""The recorder of a building: what its rooms come to, together and each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from conf import Config
from conf.rooms import Room
from training.recording.csv_log import CsvLog
from training.recording.history import MEASURES, METRICS
from training.recording.progress import Progress
from training.recording.recorder import Recorder
from training.room_evaluation import RoomScore, RoomsEvaluator, Weights, overall
from training.rooms import RoomReport
from training.run_folder import RunFolder

ROOM_METRICS = ("room", *METRICS)
ROOMS = ("round", "held_out", "room", "tick", "epsilon", *MEASURES)


class BuildingRecorder(Recorder):
    """Watches a building: a row for each episode in any room, and for each room evaluated.

    What ``metrics.csv`` and ``evaluations.csv`` say of a run they say here of all rooms: episodes
    are counted by room, and an evaluation is the mean over rooms that are trained in.

    Its arguments are those of ``Recorder``; ``evaluator`` plays frozen weights in rooms.

    Attributes:
        rooms: the rows of ``rooms.csv``.
    """

    columns = ROOM_METRICS

    def __init__(
        self,
        config: Config,
        folder: RunFolder,
        evaluator: RoomsEvaluator,
        cpu_s: Callable[[], float],
        resumed: Mapping[str, Any] | None = None,
    ) -> None:
        self._took_part: Sequence[int] = ()
        self._missing: Sequence[int] = ()
        super().__init__(config, folder, None, cpu_s, resumed)
        self._rooms_evaluator = evaluator
        kept = 0 if resumed is None else resumed["rooms"]
        self._rooms_log = CsvLog(folder.rooms_log_file, ROOMS, kept)
        self.rooms = list(self._rooms_log.kept)

    def marks(self) -> dict[str, Any]:
        """See ``Recorder.marks``."""
        self._rooms_log.sync()
        return {**super().marks(), "rooms": len(self.rooms)}

    def on_reports(
        self, progress: Progress, reports: Mapping[int, RoomReport], missing: Sequence[int]
    ) -> None:
        """Writes what the episodes of a round came to, and which rooms could not be reached."""
        self._took_part, self._missing = sorted(reports), missing
        for index in self._took_part:
            for values in reports[index].episodes:
                row = {"room": index, **dict(zip(METRICS, map(_whole, values), strict=True))}
                self.history.episodes.append(row)
                self._metrics.write(row)
        ended = [report.episodes for report in reports.values() if len(report.episodes)]
        if ended:
            means = np.concatenate(ended).mean(axis=0).tolist()
            row = dict(zip(METRICS, means, strict=True))
            self._log_events("train", row, progress.tick)

    def on_round(
        self, progress: Progress, model: Weights, ap_of: Callable[[Room], Weights]
    ) -> None:
        """Evaluates where that is due; networks as in ``RoomsEvaluator.scores``."""
        self._evaluate_where_due(progress, model, ap_of)

    def _evaluate(self, progress: Progress, robots: Weights, ap: Any) -> None:
        scores = self._rooms_evaluator.scores(robots, ap, self._config.evaluation.epsilon)
        self.write_scores(progress, scores)
        explored, greedy = overall([each for each in scores if not each.room.held_out])
        self._write_evaluation(progress, explored, greedy)

    def write_scores(self, progress: Progress, scores: Sequence[RoomScore]) -> None:
        """Writes two rows of ``rooms.csv`` for each room: with exploration, and greedy.

        Trackers get means, and each of the rooms that are evaluated on the way. The folder of each
        room gets an episode to show.
        """
        every = self._config.rooms.every
        followed = {room.name for room in self._rooms_evaluator.rooms}
        for score in scores:
            at = {
                "round": progress.window // every,
                "held_out": int(score.room.held_out),
                "room": score.room.index,
                "tick": progress.tick,
            }
            for values in (score.found.explored, score.found.greedy):
                row = {**at, **values}
                self.rooms.append(row)
                self._rooms_log.write(row)
            if score.room.name in followed:
                self._log_events(f"room_{score.room.name}", score.found.greedy, progress.tick)
            self.show_episode(self.folder.room(score.room.name), progress, score.found.episode)
        for held_out, group in ((False, "rooms"), (True, "held_out_rooms")):
            some = [score for score in scores if score.room.held_out == held_out]
            if some:
                self._log_events(group, overall(some)[1], progress.tick)

    def status(self, progress: Progress) -> dict[str, Any]:
        """See ``Recorder.status``."""
        rooms = {
            "count": self._config.rooms.count,
            "took_part": len(self._took_part),
            "missing": list(self._missing),
        }
        return {**super().status(progress), "rooms": rooms}

    def close(self) -> None:
        """See ``Recorder.close``."""
        super().close()
        self._rooms_log.close()


def _whole(value: float) -> float:
    """A number, an integer where it is whole, as files of a single room have them."""
    return int(value) if float(value).is_integer() and abs(value) < 2**53 else float(value)
