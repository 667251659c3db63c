"""The Flower messages of a building's round: what a client is asked of its rooms, and its reply."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from flwr.app import Array, ArrayRecord, ConfigRecord, MetricRecord, RecordDict

from conf import Config, from_yaml, to_yaml
from conf.rooms import from_json, to_json
from training.recording.history import METRICS
from training.rooms import RoomReport, RoomTask, RoundTask

ROOMS = "rooms"
"""The record that tells a building's train message from that of robots in lockstep."""


@dataclass(frozen=True)
class Spent:
    """What a round has cost a client.

    Attributes:
        cpu_s: processor time.
        nbytes: bytes of weights and episodes in its reply.
    """

    cpu_s: float
    nbytes: int


def asked(config: Config, fingerprint: str, task: RoundTask) -> RecordDict:
    """A round as a client is asked it; an access point's network that many take is sent once.

    Args:
        config: of the building.
        fingerprint: of the program that the rooms must be played with.
        task: with the rooms that this client hosts.
    """
    arrays = {"model": task.model}
    takes = []
    for each in task.rooms:
        known = [name for name, array in arrays.items() if array is each.ap]
        takes.append(known[0] if known else "" if each.ap is None else f"ap-{each.room.name}")
        if each.ap is not None:
            arrays[takes[-1]] = each.ap
    order = ConfigRecord(
        {
            "config": to_yaml(config),
            "fingerprint": fingerprint,
            "rooms": to_json([each.room for each in task.rooms]),
            "since": [each.since for each in task.rooms],
            "takes": takes,
            "number": task.number,
            "keep": task.keep,
        }
    )
    return RecordDict({ROOMS: order, "arrays": _record(arrays)})


def read_asked(content: RecordDict) -> tuple[Config, str, RoundTask]:
    """What ``asked`` wrote: configuration, fingerprint and task."""
    order = cast(Mapping[str, Any], content.config_records[ROOMS])
    arrays = _arrays(content)
    rooms = [
        RoomTask(room, int(since), arrays.get(takes))
        for room, since, takes in zip(
            from_json(order["rooms"]), order["since"], order["takes"], strict=True
        )
    ]
    task = RoundTask(int(order["number"]), arrays["model"], bool(order["keep"]), rooms)
    return from_yaml(order["config"]), str(order["fingerprint"]), task


def replied(reports: Mapping[int, RoomReport], cpu_s: float) -> RecordDict:
    """What rooms have come to, and the processor time that it took."""
    arrays: dict[str, Any] = {}
    for index, report in reports.items():
        arrays |= {f"model-{index}": report.model, f"ap-{index}": report.ap}
        arrays[f"episodes-{index}"] = report.episodes
    ticks = ConfigRecord(
        {"rooms": list(reports), "ticks": [report.ticks for report in reports.values()]}
    )
    return RecordDict(
        {ROOMS: ticks, "arrays": _record(arrays), "metrics": MetricRecord({"cpu_s": cpu_s})}
    )


def read_reply(
    content: RecordDict, rooms: Sequence[int], shape: tuple[int, ...]
) -> tuple[dict[int, RoomReport], Spent]:
    """What ``replied`` wrote.

    Args:
        content: of the reply.
        rooms: those that were asked.
        shape: of a robot's weights, (2, P).

    Raises:
        ValueError: it is of other rooms, or weights of another type or shape.
    """
    said = cast(Mapping[str, Any], content.config_records[ROOMS])
    arrays = _arrays(content)
    ticks = dict(zip(said["rooms"], said["ticks"], strict=True))
    if sorted(ticks) != sorted(rooms):
        raise ValueError(f"a reply of rooms {sorted(ticks)} where {sorted(rooms)} were asked")
    reports = {}
    for index in rooms:
        model, ap, episodes = (
            arrays.get(f"{name}-{index}") for name in ("model", "ap", "episodes")
        )
        if model is None or model.shape != shape or model.dtype != np.float32:
            raise ValueError(f"room {index} replied no float32 network of shape {shape}")
        if ap is None or ap.ndim != 2 or ap.dtype != np.float32:
            raise ValueError(f"room {index} replied no network of its access point")
        if episodes is None or episodes.ndim != 2 or episodes.shape[1] != len(METRICS):
            raise ValueError(f"room {index} replied no rows of its episodes")
        reports[index] = RoomReport(model, ap, int(ticks[index]), episodes)
    spent = float(cast(float, content.metric_records["metrics"]["cpu_s"]))
    return reports, Spent(spent, sum(array.nbytes for array in arrays.values()))


def _record(arrays: Mapping[str, Any]) -> ArrayRecord:
    return ArrayRecord({name: Array(array) for name, array in arrays.items()})


def _arrays(content: RecordDict) -> dict[str, Any]:
    found = content.array_records["arrays"]
    return {name: found[name].numpy() for name in found}
