"""What a hostile peer may send: frames of every kind that there is, and what becomes of them."""

import dataclasses
import typing

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from link_helpers import PARAMETERS, SHAPE, WIDE, token
from numpy.typing import NDArray

from lockstep import frames
from lockstep.errors import FrameError
from lockstep.messages import PLAIN, VERSION, Expect, Hello, Step, Weights
from lockstep.wire_format import BODY_LIMITS, HEADER, MAGIC, Kind

_NUMBERS = st.integers(0, 12) | st.integers(-1, 2**64)
_TEXTS = st.text(st.sampled_from("aZ0 \n\0\x1b\u00e9\u20ac\ud800\U0001f916"), max_size=40)
LAYOUTS = (PLAIN, WIDE)


def _records(count, record):
    """So many records of any bytes."""
    size = count * record.itemsize
    return st.binary(min_size=size, max_size=size).map(lambda data: np.frombuffer(data, record))


_RECORDS = st.builds(
    _records, st.integers(0, 5), st.sampled_from([layout.record for layout in LAYOUTS])
).flatmap(lambda records: records)
_SHAPES = st.sampled_from([SHAPE, (1, *SHAPE), (3, *SHAPE)]) | hnp.array_shapes(max_side=4)
_BITS = {
    "i": st.integers(-(2**31), 2**31 - 1),
    "u": st.integers(0, 255),
    "f": st.sampled_from([0.0, 1.0, -1.5, float("nan"), float("inf"), 1e38]),
}


def _field(hint):
    """Values for a field of a message, by its type."""
    if hint in (int, str, bytes, bool):
        return {
            int: _NUMBERS,
            str: _TEXTS,
            bytes: st.binary(max_size=40),
            bool: st.booleans(),
        }[hint]
    if hint is np.ndarray:
        return _RECORDS
    if isinstance(hint, type) and issubclass(hint, Expect):
        return st.sampled_from(hint)
    if typing.get_origin(hint) is np.ndarray:
        of = typing.get_args(typing.get_args(hint)[1])[0]
        if of is typing.Any:  # weights, plain or packed
            return _field(NDArray[np.float32]) | _field(NDArray[np.uint8])
        dtype = np.dtype(of)
        shapes = st.integers(0, 5) if dtype.kind == "i" else _SHAPES
        return hnp.arrays(dtype, shapes, elements=_BITS[dtype.kind], fill=st.nothing())
    if typing.get_origin(hint) in (list, tuple):
        return st.lists(_field(typing.get_args(hint)[0]), max_size=5)
    return st.one_of(
        [st.none() if arg is type(None) else _field(arg) for arg in typing.get_args(hint)]
    )


def messages_of(message_type):
    """Messages of one type, whatever their values."""
    hints = typing.get_type_hints(message_type)
    names = [field.name for field in dataclasses.fields(message_type)]
    return st.builds(message_type, **{name: _field(hints[name]) for name in names})


def _encoded(message):
    try:
        return frames.encode(message)
    except (FrameError, UnicodeEncodeError):
        return None


MESSAGE_TYPES = tuple(typing.get_args(frames.Message))  # type: ignore[attr-defined]
valid_frames = (
    st.sampled_from(MESSAGE_TYPES)
    .flatmap(messages_of)
    .map(_encoded)
    .filter(lambda frame: frame is not None)
)
"""Frames of every message that the link knows, among them those that come out of turn."""

hellos = st.builds(
    Hello,
    st.sampled_from([VERSION, VERSION + 1]),
    st.sampled_from(["v1", "v2"]),
    st.sampled_from([[0], [1], [1, 2], [2, 1], [0, 1, 2], [7]]),
    st.lists(st.sampled_from(["wrong", token(7), ""]), min_size=1, max_size=3),
).map(frames.encode)
"""Hellos that never hold a valid token: other versions, other robots, other numbers of tokens."""

framed_bodies = st.builds(
    lambda kind, version, zero, body, extra: (
        HEADER.pack(MAGIC, version, kind, zero, max(0, len(body) + extra)) + body
    ),
    st.sampled_from(list(Kind)) | st.integers(0, 255),
    st.sampled_from([VERSION, VERSION, VERSION + 1]),
    st.sampled_from([0, 0, 1]),
    st.binary(max_size=200),
    st.sampled_from([0, 0, 1, -1, 2**31, *BODY_LIMITS.values()]),
)
"""A sound header over any body, with a length that may be wrong."""


@st.composite
def mutated_frames(draw):
    """Valid frames with bytes changed, cut out, put in, or the end of another frame."""
    data = bytearray(draw(valid_frames | hellos))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(data)))
        how = draw(st.sampled_from(["change", "cut", "insert", "end", "splice"]))
        if how == "change" and at < len(data):
            data[at] = draw(st.integers(0, 255))
        elif how == "cut":
            del data[at : at + draw(st.integers(1, 30))]
        elif how == "insert":
            data[at:at] = draw(st.binary(max_size=30))
        elif how == "end":
            del data[at:]
        else:
            data[at:] = draw(valid_frames)[at:]
    return bytes(data)


pieces = (
    st.binary(max_size=300)
    | valid_frames
    | hellos
    | framed_bodies
    | mutated_frames()
    | valid_frames.map(lambda frame: frame * 20)
)
scripts = st.lists(pieces, max_size=4)
"""What a peer sends, piece by piece."""


def good_conversation(layout=PLAIN):
    """What a server says to the one robot that it leads through a window, frame by frame."""
    records = np.zeros(layout.worlds, layout.record)
    model = np.zeros((2, PARAMETERS), np.float32)
    return [
        Step(0, 1, Expect.ACTIONS, records),
        Step(1, 1, Expect.WEIGHTS, records),
        Weights(1, model),
        Step(1, 2, Expect.ACTIONS, records),
    ]
