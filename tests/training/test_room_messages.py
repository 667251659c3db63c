"""The messages of a building's round: what is asked arrives, and what is wrong is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from flwr.app import Array, ArrayRecord, ConfigRecord, MetricRecord, RecordDict

from agent.networks.limits import WEIGHT_LIMIT
from conf import Config
from conf.rooms import rooms_of
from training.recording.history import METRICS
from training.room_messages import ROOMS, asked, read_asked, read_reply, replied
from training.rooms import RoomReport, RoomTask, RoundTask

Building = Callable[..., Config]
P, P_AP = 7, 5
SHAPES = {3: {"model": (2, P), "ap": (2, P_AP)}, 5: {"model": (2, P), "ap": (2, 0)}}
"""Of two rooms, the second with an access point that learns nothing."""


def weights(seed: int, size: int) -> Any:
    return np.random.default_rng(seed).standard_normal((2, size), np.float32)


def report(index: int, episodes: int = 2) -> RoomReport:
    """A room's, with a measure that is not a number, as success without an arrival leaves it."""
    rows = np.random.default_rng(index).random((episodes, len(METRICS)))
    rows[:, METRICS.index("path_ratio")] = np.nan
    model, ap = weights(index, P), weights(index, SHAPES[index]["ap"][1])
    return RoomReport(model, ap, 10 * index, rows)


def reply() -> RecordDict:
    """What two rooms reply, as it crosses a wire."""
    return replied({3: report(3), 5: report(5, 0)}, 1.5)


# --- There and back -------------------------------------------------------------------------------


def test_a_round_arrives_as_it_is_asked(tiny_building: Building) -> None:
    config = tiny_building({"rooms.plans": ["default", "corridor"], "run.dir": "/tmp/größe"})
    rooms = rooms_of(config, check=False)
    given = [
        RoomTask(rooms[0], 0, weights(1, P_AP)),
        RoomTask(rooms[1], 4, None),
        RoomTask(rooms[2], 2, weights(2, P_AP)),
    ]
    for keep in (False, True):
        sent = RoundTask(6, weights(0, P), keep, given, frozenset({1}))
        content = asked(config, "fp", sent)
        found, fingerprint, task = read_asked(content)
        assert (found, fingerprint) == (config, "fp")
        assert (task.number, task.keep, task.played) == (6, keep, frozenset())
        assert np.array_equal(task.model, sent.model)
        assert [(each.room, each.since) for each in task.rooms] == [
            (each.room, each.since) for each in given
        ]
        for one, other in zip(task.rooms, given, strict=True):
            assert (one.ap is None) == (other.ap is None)
            assert other.ap is None or np.array_equal(one.ap, other.ap)


def test_a_network_that_many_rooms_take_is_sent_once(tiny_building: Building) -> None:
    config = tiny_building()
    rooms, shared = rooms_of(config, check=False)[:3], weights(1, P_AP)
    content = asked(config, "fp", RoundTask(1, weights(0, P), True, [
        RoomTask(room, 0, shared) for room in rooms
    ]))  # fmt: skip
    assert len(content.array_records["arrays"]) == 2
    for each in read_asked(content)[2].rooms:
        assert np.array_equal(each.ap, shared)


def test_reports_arrive_as_they_are_replied() -> None:
    content = reply()
    found, spent = read_reply(content, SHAPES)
    assert sorted(found) == [3, 5]
    for index, episodes in ((3, 2), (5, 0)):
        expected = report(index, episodes)
        assert found[index].ticks == expected.ticks
        for name in ("model", "ap", "episodes"):
            one, other = getattr(found[index], name), getattr(expected, name)
            assert one.dtype == other.dtype
            assert np.array_equal(one, other, equal_nan=True)
    assert spent.cpu_s == 1.5
    assert spent.nbytes == 2 * 2 * P * 4 + 2 * P_AP * 4 + 2 * len(METRICS) * 8


# --- What is refused ------------------------------------------------------------------------------


def with_array(name: str, array: Any) -> Callable[[RecordDict], None]:
    """Puts another array in a reply's, or takes it out."""

    def spoil(content: RecordDict) -> None:
        record = content.array_records["arrays"]
        if array is None:
            del record[name]
        else:
            record[name] = Array(array)

    return spoil


def with_said(**values: Any) -> Callable[[RecordDict], None]:
    """Lets a reply say something else of its rooms."""

    def spoil(content: RecordDict) -> None:
        record = content.config_records[ROOMS]
        content[ROOMS] = ConfigRecord({**record, **values})

    return spoil


def with_spent(cpu_s: float) -> Callable[[RecordDict], None]:
    """Lets a reply say another processor time."""

    def spoil(content: RecordDict) -> None:
        content["metrics"] = MetricRecord({"cpu_s": cpu_s})

    return spoil


def spoilt(seed: int, size: int, value: float) -> Any:
    """Weights with one that is something else."""
    array = weights(seed, size)
    array[1, size // 2] = value
    return array


NOT_A_NETWORK = "room 3 replied no float32 network of shape"
ROWS = "room 3 replied no rows of its episodes"
SPOILT = [
    (with_array("model-3", None), rf"{NOT_A_NETWORK} \(2, 7\) of its robots"),
    (with_array("model-3", weights(0, P - 1)), NOT_A_NETWORK),
    (with_array("model-3", weights(0, P)[0]), NOT_A_NETWORK),
    (with_array("model-3", weights(0, P).astype(np.float64)), NOT_A_NETWORK),
    (with_array("model-3", weights(0, P).view(np.int32)), NOT_A_NETWORK),
    (with_array("model-3", spoilt(0, P, np.nan)), "room 3 replied absurd weights of its robots"),
    (with_array("model-3", spoilt(0, P, np.inf)), "room 3 replied absurd weights"),
    (with_array("model-3", spoilt(0, P, -2 * WEIGHT_LIMIT)), r"absurd weights .* \(2e\+04\)"),
    (with_array("ap-3", None), rf"{NOT_A_NETWORK} \(2, 5\) of its access point"),
    (with_array("ap-3", weights(0, P_AP + 1)), NOT_A_NETWORK),
    (with_array("ap-3", weights(0, P_AP).astype(np.float16)), NOT_A_NETWORK),
    (with_array("ap-3", spoilt(0, P_AP, np.nan)), "absurd weights of its access point"),
    (with_array("ap-5", weights(0, P_AP)), r"room 5 replied no float32 network of shape \(2, 0\)"),
    (with_array("episodes-3", None), ROWS),
    (with_array("episodes-3", np.zeros(len(METRICS))), ROWS),
    (with_array("episodes-3", np.zeros((2, len(METRICS) - 1))), ROWS),
    (with_array("episodes-3", np.zeros((2, len(METRICS)), np.float32)), ROWS),
    (with_array("episodes-3", np.array(0.0)), ROWS),
    (with_said(rooms=[3]), r"a reply of rooms \[3\] where \[3, 5\] were asked"),
    (with_said(rooms=[3, 4]), r"a reply of rooms \[3, 4\] where \[3, 5\] were asked"),
    (with_said(rooms=[3, 5, 6], ticks=[1, 2, 3]), r"a reply of rooms \[3, 5, 6\]"),
    (with_said(rooms=[3, 5, 5], ticks=[1, 2, 3]), r"a reply of rooms \[3, 5, 5\]"),
    (with_said(ticks=[30]), "zip"),
    (with_said(ticks=[-1, 50]), "room 3 replied -1 ticks"),
    (with_said(ticks=["30", "50"]), "room 3 replied 30 ticks"),
    (with_said(ticks=[30.5, 50.0]), "room 3 replied 30.5 ticks"),
    (with_spent(-1.0), "a reply of -1 s of processor time"),
    (with_spent(float("nan")), "a reply of nan s of processor time"),
    (with_spent(float("inf")), "a reply of inf s of processor time"),
]


@pytest.mark.parametrize(("spoil", "message"), SPOILT)
def test_a_reply_that_no_room_gives_is_refused(
    spoil: Callable[[RecordDict], None], message: str
) -> None:
    content = reply()
    spoil(content)
    with pytest.raises(ValueError, match=message):
        read_reply(content, SHAPES)


@pytest.mark.parametrize("part", [ROOMS, "arrays", "metrics"])
def test_a_reply_without_one_of_its_parts_is_refused(part: str) -> None:
    content = reply()
    del content[part]
    with pytest.raises(LookupError):
        read_reply(content, SHAPES)


@pytest.mark.parametrize("key", ["rooms", "ticks"])
def test_a_reply_that_leaves_something_out_is_refused(key: str) -> None:
    content = reply()
    del content.config_records[ROOMS][key]
    with pytest.raises(LookupError):
        read_reply(content, SHAPES)


def test_arrays_are_never_unpickled() -> None:
    content = reply()
    evil = Array("float32", (2, P), "numpy.ndarray", pickled())
    content["arrays"] = ArrayRecord({**content.array_records["arrays"], "model-3": evil})
    with pytest.raises(ValueError, match="allow_pickle"):
        read_reply(content, SHAPES)


def pickled() -> bytes:
    """An array of objects, as NumPy saves it."""
    import io

    file = io.BytesIO()
    np.save(file, np.array([{}], dtype=object), allow_pickle=True)
    return file.getvalue()
