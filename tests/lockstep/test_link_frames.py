"""The codec: what goes in comes out, and nothing else gets through."""

import contextlib
import json
import struct

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from lockstep.errors import FrameError
from lockstep.frames import actions_in, decode, encode
from lockstep.messages import (
    MAX_ROBOTS,
    PLAIN,
    UPDATE,
    VERSION,
    Actions,
    Expect,
    Failure,
    Hello,
    Layout,
    Rejection,
    Step,
    Weights,
    Welcome,
)
from lockstep.wire_format import (
    HEADER,
    HELLO_SIZE,
    MAGIC,
    Kind,
    actions_size,
    frame_size,
    step_size,
    weights_size,
)

counts = st.integers(1, 9)
ticks = st.integers(0, 2**64 - 1)
windows = st.integers(0, 2**32 - 1)
lines = st.text(st.characters(categories=["L", "N", "P"]), max_size=300)


layouts = st.builds(Layout, st.integers(1, 4), st.integers(0, 6), st.booleans())


@st.composite
def steps(draw, layout=PLAIN):
    size = draw(counts) * layout.worlds * layout.record.itemsize
    records = np.frombuffer(draw(st.binary(min_size=size, max_size=size)), layout.record).copy()
    records["flags"] &= 7
    return Step(draw(ticks), draw(windows), draw(st.sampled_from(Expect)), records)


actions = st.builds(Actions, ticks, hnp.arrays("<i4", counts))
weights = st.builds(
    Weights,
    windows,
    hnp.arrays("<f4", hnp.array_shapes(min_dims=2, max_dims=3, max_side=5))
    | hnp.arrays(np.uint8, hnp.array_shapes(min_dims=1, max_dims=2, max_side=5)),
)
hellos = st.integers(1, 9).flatmap(
    lambda n: st.builds(
        Hello,
        st.integers(0, 2**16 - 1),
        lines,
        st.lists(st.integers(0, MAX_ROBOTS - 1), min_size=n, max_size=n),
        st.lists(lines.map(lambda text: text[:256]), min_size=n, max_size=n),
    )
)
texts = st.builds(Rejection, lines) | st.builds(Failure, lines) | st.just(Welcome())
messages = steps() | actions | weights | hellos | texts


def plain(message):
    """A message as something that compares bit by bit."""
    fields = {name: getattr(message, name) for name in message.__slots__}
    return type(message), {
        name: (v.dtype, v.shape, v.tobytes()) if isinstance(v, np.ndarray) else v
        for name, v in fields.items()
    }


def framed(kind, body, *, magic=MAGIC, version=VERSION, zero=0, length=None):
    length = len(body) if length is None else length
    return HEADER.pack(magic, version, kind, zero, length) + body


@given(messages)
def test_a_message_comes_out_of_its_frame_as_it_went_in(message):
    frame = encode(message)
    assert frame_size(memoryview(frame), len(frame)) == len(frame)
    assert plain(decode(frame)) == plain(message)


def test_frames_have_the_announced_sizes():
    step = Step(1, 1, Expect.ACTIONS, np.zeros(3, UPDATE))
    assert len(encode(step)) == step_size(3, PLAIN)
    assert len(encode(Actions(1, np.zeros(3, np.int32)))) == actions_size(3, PLAIN)
    assert len(encode(Actions(1, np.zeros(6, np.int32)))) == actions_size(3, Layout(worlds=2))
    assert len(encode(Weights(1, np.zeros((3, 2, 5), np.float32)))) == weights_size((3, 2, 5))
    assert UPDATE.itemsize == 26


def test_the_layout_of_a_record_by_hand():
    record = Layout(worlds=3, broadcast=2, credit=True).record
    names = (*UPDATE.names, "credit", "outcome_broadcast", "broadcast")
    assert record.names == names
    assert {name: record.fields[name][1] for name in names[6:]} == {
        "credit": 26,
        "outcome_broadcast": 34,
        "broadcast": 42,
    }
    assert record.itemsize == 50
    assert Layout(credit=True).record.itemsize == 34
    assert Layout(broadcast=5).record.itemsize == 66
    assert Layout(worlds=7).record == UPDATE


def test_rows_of_a_block_are_its_robots_worlds_side_by_side():
    layout = Layout(worlds=3)
    assert layout.rows_of((2, 3)) == slice(6, 12)
    assert list(layout.rows_of((2, 0))) == [6, 7, 8, 0, 1, 2]
    assert PLAIN.rows_of((1,)) == slice(1, 2)


@given(layouts, st.data())
def test_a_step_of_any_layout_comes_out_of_its_frame_as_it_went_in(layout, data):
    step = data.draw(steps(layout))
    frame = encode(step)
    robots = len(step.updates) // layout.worlds
    assert len(frame) == frame_size(memoryview(frame), len(frame)) == step_size(robots, layout)
    assert plain(decode(frame, layout)) == plain(step)


@given(layouts, layouts, st.data())
def test_records_of_another_size_are_refused(layout, other, data):
    assume(layout.record.itemsize != other.record.itemsize)
    with pytest.raises(FrameError, match=r"malformed STEP frame: \d+ bytes are not \d+ records"):
        decode(encode(data.draw(steps(layout))), other)


def test_flags_are_checked_in_every_record_of_a_layout():
    layout = Layout(worlds=2, broadcast=3, credit=True)
    for row in range(4):
        records = np.zeros(4, layout.record)
        records["broadcast"] = np.nan  # whose bytes are above all flags
        decode(encode(Step(1, 1, Expect.ACTIONS, records)), layout)
        records["flags"][row] = 8
        with pytest.raises(FrameError, match="unknown flags"):
            decode(encode(Step(1, 1, Expect.ACTIONS, records)), layout)


@given(st.binary(max_size=200))
def test_random_bytes_are_refused_with_a_reason(data):
    with pytest.raises(FrameError, match=r"\w"):
        decode(data)


@given(st.sampled_from(list(Kind)), st.binary(max_size=200))
def test_random_bodies_are_refused_or_sound(kind, body):
    try:
        message = decode(framed(kind, body))
    except FrameError:
        return
    decode(encode(message))


@given(messages, st.data())
def test_a_flipped_bit_never_does_worse_than_a_frame_error(message, data):
    frame = bytearray(encode(message))
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[bit // 8] ^= 1 << bit % 8
    with contextlib.suppress(FrameError):
        decode(bytes(frame))


@given(messages, st.data())
def test_truncated_and_lengthened_frames_are_refused(message, data):
    frame = encode(message)
    cut = data.draw(st.integers(0, len(frame) - 1))
    for wrong in (frame[:cut], frame + b"\0"):
        with pytest.raises(FrameError):
            decode(wrong)


def test_a_frame_over_the_readers_limit_is_refused_by_its_header_alone():
    head = memoryview(framed(Kind.WEIGHTS, b"", length=2**20))
    assert frame_size(head, 2**21) == HEADER.size + 2**20
    with pytest.raises(FrameError, match="of at most 4096"):
        frame_size(head, 4096)


@pytest.mark.parametrize("kind", list(Kind))
def test_every_kind_has_a_limit_of_its_own(kind):
    with pytest.raises(FrameError, match=kind.name):
        frame_size(memoryview(framed(kind, b"", length=2**32 - 1)), 2**40)


def test_the_limit_before_the_hello_is_small_and_holds_the_largest_hello():
    hello = Hello(VERSION, "f" * 1000, list(range(MAX_ROBOTS)), ["t" * 64] * MAX_ROBOTS)
    assert len(encode(hello)) <= HELLO_SIZE <= 2**16


@pytest.mark.parametrize(
    "frame",
    [
        framed(Kind.WELCOME, b"{}", magic=b"HTTP"),
        framed(Kind.WELCOME, b'{"version": 1}', zero=1),
        framed(99, b""),
        framed(Kind.ACTIONS, struct.pack("<QIi", 1, 1, 0), version=VERSION + 1),
        framed(Kind.ACTIONS, struct.pack("<QI", 1, 0)),
        framed(Kind.ACTIONS, struct.pack("<QIi", 1, 2, 0)),
        framed(Kind.STEP, struct.pack("<QIBxH", 1, 1, 3, 1) + bytes(26)),
        framed(Kind.STEP, struct.pack("<QIBxH", 1, 1, 0, 1) + b"\x08" + bytes(25)),
        framed(Kind.STEP, struct.pack("<QIBxH", 1, 1, 0, 1) + b"\0\1" + bytes(24)),
        framed(Kind.STEP, struct.pack("<QIBxH", 1, 1, 0, 0)),
        framed(Kind.WEIGHTS, struct.pack("<IB3xIII", 1, 2, 1, 1, 1) + bytes(4)),
        framed(Kind.WEIGHTS, struct.pack("<IB3xIII", 1, 4, 1, 1, 1) + bytes(4)),
        framed(Kind.WEIGHTS, struct.pack("<IB3xIII", 1, 3, 2**31, 2**31, 4)),
        framed(Kind.RESTORE, struct.pack("<IIII", 1, 20, 2, 1) + bytes(4)),
        framed(Kind.RESTORE, struct.pack("<IIII", 1, 20, 0, 7)),
        framed(Kind.RESTORE, struct.pack("<III", 1, 20, 0)),
        framed(Kind.ACK, b"\0\0\0"),
        framed(Kind.ACK, struct.pack("<IH", 1, 2) + bytes(4)),
        framed(Kind.ABORT, bytes(5)),
        framed(Kind.REFUSED, b"\xff\xfe"),
    ],
)
def test_malformed_frames_are_refused(frame):
    with pytest.raises(FrameError):
        decode(frame)


@pytest.mark.parametrize(
    "change",
    [
        {"version": "1"},
        {"version": -1},
        {"version": True},
        {"robots": []},
        {"robots": [0.0]},
        {"robots": [MAX_ROBOTS]},
        {"robots": list(range(MAX_ROBOTS + 1))},
        {"robots": "0"},
        {"tokens": [7]},
        {"tokens": ["a\nb"]},
        {"tokens": ["\ud800"]},
        {"tokens": None},
        {"fingerprint": "f" * 2000},
        {"fingerprint": None},
    ],
)
def test_a_malformed_hello_is_refused(change):
    fields = {"version": 1, "fingerprint": "v1", "robots": [0], "tokens": ["t"]}
    decode(framed(Kind.HELLO, json.dumps(fields).encode()))
    with pytest.raises(FrameError, match="HELLO"):
        decode(framed(Kind.HELLO, json.dumps(fields | change).encode()))


@pytest.mark.parametrize("body", [b"", b"[]", b"{", b"[" * 60_000, b"9" * 60_000, b"\xff"])
def test_a_hello_that_is_no_json_object_is_refused(body):
    with pytest.raises(FrameError, match="HELLO"):
        decode(framed(Kind.HELLO, body))


def test_a_hello_of_another_version_can_be_read_and_may_hold_more():
    fields = {"version": 2, "fingerprint": "v2", "robots": [0], "tokens": ["t"], "resume": [3]}
    body = json.dumps(fields).encode()
    assert decode(framed(Kind.HELLO, body, version=2)) == Hello(2, "v2", [0], ["t"])
    assert decode(framed(Kind.REFUSED, b"no", version=2)) == Rejection("no")


def test_texts_travel_as_one_short_line():
    message = decode(encode(Failure("first\nsecond\x1b[31m" + "x" * 5000)))
    assert message.reason.isprintable()
    assert message.reason.startswith("first second")
    assert len(message.reason) == 1000


@pytest.mark.parametrize(
    "message",
    [
        Step(-1, 1, Expect.ACTIONS, np.zeros(1, UPDATE)),
        Step(1, 2**32, Expect.ACTIONS, np.zeros(1, UPDATE)),
        Actions(2**64, np.zeros(1, np.int32)),
        Weights(-1, np.zeros((2, 3), np.float32)),
        Weights(1, np.zeros(3, np.float32)),
        Weights(1, np.zeros((2, 0), np.float32)),
        Hello(1, "v1", [0], ["t" * 2**17]),
    ],
)
def test_what_does_not_fit_its_frame_is_not_sent(message):
    with pytest.raises(FrameError):
        encode(message)


def test_actions_must_answer_the_step():
    frame = memoryview(encode(Actions(7, np.array([3, -1], np.int32))))
    assert actions_in(frame, 7, 2).tolist() == [3, -1]
    for tick, count, match in ((8, 2, "of tick 8"), (7, 3, "2 actions where 3 are due")):
        with pytest.raises(FrameError, match=match):
            actions_in(frame, tick, count)
    with pytest.raises(FrameError, match="Welcome"):
        actions_in(memoryview(encode(Welcome())), 7, 2)


def test_a_hello_shows_no_token():
    assert "secret" not in repr(Hello(1, "v1", [0], ["secret"]))
