"""What a run has come to, after each round in a file, and the newest whole one of a folder."""

from __future__ import annotations

import dataclasses
import logging
import os
import uuid
from pathlib import Path
from typing import Any

from flwr.app import ArrayRecord, ConfigRecord, MetricRecord, RecordDict
from flwr.serverapp.strategy import Result

from repeatable.records import packed, unpacked
from storage.checkpoint_files import (
    Arrays,
    CheckpointError,
    Json,
    checkpoints,
    load_checkpoint,
    save_checkpoint,
)

_MODEL, _TRAIN, _EVALUATE = "arrays", "train-config", "evaluate-config"
_HISTORIES = ("train_metrics_clientapp", "evaluate_metrics_clientapp", "evaluate_metrics_serverapp")
_STRATEGY = "strategy/"


class OtherRunError(ValueError):
    """The folder holds another run than the one that is to be played."""


@dataclasses.dataclass
class Progress:
    """What a run has come to.

    Attributes:
        result: what Flower's ``start`` returns: the global model, and metrics of all rounds.
        train_config: what a strategy has made of the configuration of clients that train.
        evaluate_config: the same of those that evaluate.
        round: the last round that is whole, 0 before the first.
        run: the run's identity, by which clients know their states.
        strategy: what the strategy keeps.
    """

    result: Result
    train_config: ConfigRecord
    evaluate_config: ConfigRecord
    round: int = 0
    run: str = dataclasses.field(default_factory=lambda: uuid.uuid4().hex)
    strategy: Arrays = dataclasses.field(default_factory=dict)

    def configuration(self) -> Json:
        """Both configurations as JSON has them."""
        return packed(RecordDict({_TRAIN: self.train_config, _EVALUATE: self.evaluate_config}))[1]

    def copy(self) -> Progress:
        """One that may change and leaves this one as it is; arrays and metrics are shared."""
        histories = (dict(getattr(self.result, name)) for name in _HISTORIES)
        return dataclasses.replace(
            self,
            result=Result(self.result.arrays, *histories),
            train_config=ConfigRecord({**self.train_config}),
            evaluate_config=ConfigRecord({**self.evaluate_config}),
        )


def state_folder(place: str | os.PathLike[str] | None) -> Path | None:
    """The folder that an app is told to keep its state in; None where it is to keep none.

    Raises:
        ValueError: it is not absolute.
    """
    if not place:
        return None
    folder = Path(place).expanduser()
    if not folder.is_absolute():
        raise ValueError(
            f"state-dir={place}: allowed is an absolute path, since each of Flower's processes"
            " works in a folder of its own"
        )
    return folder


def save(folder: Path, progress: Progress, owner: dict[str, Json]) -> None:
    """Writes a checkpoint of a round, whole or not at all, to an app's folder.

    ``owner`` is what another start of the same run has, too.
    """
    records = RecordDict({_MODEL: progress.result.arrays, _TRAIN: progress.train_config})
    records[_EVALUATE] = progress.evaluate_config
    for history in _HISTORIES:
        for number, metrics in getattr(progress.result, history).items():
            records[f"{history}/{number}"] = metrics
    arrays, described = packed(records)
    strategy = {f"{_STRATEGY}{name}": array for name, array in progress.strategy.items()}
    meta: dict[str, Json] = {**owner, "run": progress.run, "records": described}
    meta["kept"] = list(progress.strategy)
    save_checkpoint(_place(folder), progress.round, arrays | strategy, meta)


def newest(folder: Path, owner: dict[str, Json]) -> Progress | None:
    """The newest whole checkpoint of a run that ``save`` knew by this owner; None without any.

    Raises:
        OtherRunError: it is another run's.
        CheckpointError: there are some, and none is whole.
    """
    found = _newest_whole(folder)
    if found is None:
        return None
    step, arrays, meta = found
    for name, value in owner.items():
        if meta.get(name) != value:
            raise OtherRunError(
                f"state-dir={folder} holds a run with {name} {meta.get(name)}, and this one has"
                f" {value}: give it a folder of its own"
            )
    records = unpacked(arrays, meta["records"])
    result = Result(records.array_records[_MODEL])
    for name, record in records.items():
        history, _, number = name.partition("/")
        if number and isinstance(record, MetricRecord):
            getattr(result, history)[int(number)] = record
    train, evaluate = (records.config_records[name] for name in (_TRAIN, _EVALUATE))
    strategy = {name: arrays[f"{_STRATEGY}{name}"] for name in meta["kept"]}
    return Progress(result, train, evaluate, step, meta["run"], strategy)


def newest_arrays(folder: Path) -> tuple[int, ArrayRecord] | None:
    """The newest whole round in an app's folder, and its global model; None where there is none."""
    found = _newest_whole(folder)
    if found is None:
        return None
    step, arrays, meta = found
    return step, unpacked(arrays, meta["records"]).array_records[_MODEL]


def newest_round(folder: Path) -> int:
    """The newest round in an app's folder, which need not be whole; -1 where there is none."""
    return max(checkpoints(_place(folder)), default=-1)


def round_s(folder: Path) -> float:
    """What a round took in the mean of the last ones, in s; 0 where there are none."""
    ends = sorted(path.stat().st_mtime for path in _place(folder).glob("checkpoint-*"))
    return (ends[-1] - ends[0]) / (len(ends) - 1) if len(ends) > 1 else 0.0


def _newest_whole(folder: Path) -> tuple[int, Arrays, dict[str, Any]] | None:
    damage: CheckpointError | None = None
    for step in reversed(checkpoints(_place(folder))):
        try:
            return step, *load_checkpoint(_place(folder), step)
        except CheckpointError as error:
            logging.getLogger("flwr").warning("%s; an earlier one is taken", error)
            damage = error
    if damage is not None:
        raise damage
    return None


def _place(folder: Path) -> Path:
    return folder / "server"
