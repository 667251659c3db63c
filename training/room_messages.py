"""The Flower messages of a building's round: what a client is asked of its rooms, and its reply."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from flwr.app import Array, ArrayRecord, ConfigRecord, MetricRecord, RecordDict
from numpy.typing import NDArray

from agent.networks.limits import check_weights
from conf import Config, from_yaml, to_yaml
from conf.rooms import from_json, to_json
from training.recording.history import METRICS
from training.rooms import RoomReport, RoomTask, RoundTask

ROOMS = "rooms"
"""The record that tells a building's train message from that of robots in lockstep."""


@dataclass(frozen=True)
class Spent:
    """What a round has cost a client: processor time, and bytes of arrays in its reply."""

    cpu_s: float
    nbytes: int


def asked(config: Config, fingerprint: str, task: RoundTask) -> RecordDict:
    """A round as a client is asked it; an access point's network that many take is sent once.

    The configuration is the building's, the fingerprint of the program that its rooms must be
    played with; the task has the rooms that this client hosts.
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
    content: RecordDict, shapes: Mapping[int, Mapping[str, tuple[int, ...]]]
) -> tuple[dict[int, RoomReport], Spent]:
    """What ``replied`` wrote.

    Args:
        content: of the reply.
        shapes: for each room that was asked, of its weights: "model" (2, P) and "ap" (2, P_AP).

    Raises:
        LookupError: a part of it is missing.
        ValueError: it is of other rooms, of weights of another type or shape or absurd ones, or of
            numbers that no room comes to.
    """
    said = cast(Mapping[str, Any], content.config_records[ROOMS])
    arrays = _arrays(content)
    if sorted(said["rooms"]) != sorted(shapes):
        raise ValueError(f"a reply of rooms {said['rooms']} where {sorted(shapes)} were asked")
    reports = {}
    for index, ticks in zip(said["rooms"], said["ticks"], strict=True):
        model, ap = (
            _weights(index, name, arrays.get(f"{name}-{index}"), shape)
            for name, shape in shapes[index].items()
        )
        episodes = arrays.get(f"episodes-{index}")
        is_table = episodes is not None and episodes.shape[1:] == (len(METRICS),)
        if episodes is None or not is_table or episodes.dtype != np.float64:
            raise ValueError(f"room {index} replied no rows of its episodes")
        if not (isinstance(ticks, int) and ticks >= 0):
            raise ValueError(f"room {index} replied {ticks} ticks")
        reports[index] = RoomReport(model, ap, ticks, episodes)
    spent = float(cast(float, content.metric_records["metrics"]["cpu_s"]))
    if not 0 <= spent < math.inf:
        raise ValueError(f"a reply of {spent:g} s of processor time")
    return reports, Spent(spent, sum(array.nbytes for array in arrays.values()))


def _weights(index: int, name: str, found: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """A room's weights; a ``ValueError`` if they are missing, of another shape, or absurd."""
    whose = "its robots" if name == "model" else "its access point"
    if found is None or found.shape != shape or found.dtype != np.float32:
        raise ValueError(f"room {index} replied no float32 network of shape {shape} of {whose}")
    if found.size:  # an access point that learns nothing has none
        check_weights(found, f"room {index} replied absurd weights of {whose}")
    weights: NDArray[np.float32] = found
    return weights


def _record(arrays: Mapping[str, Any]) -> ArrayRecord:
    return ArrayRecord({name: Array(array) for name, array in arrays.items()})


def _arrays(content: RecordDict) -> dict[str, Any]:
    found = content.array_records["arrays"]
    return {name: found[name].numpy() for name in found}
