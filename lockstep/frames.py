"""Messages as length-prefixed binary frames, and back.

A frame is a header of 12 bytes (magic, version, kind, zero, length of the body; little-endian)
and a body of fixed layout. `HELLO` (JSON) and `REFUSED` (UTF-8) keep their layout in all versions
and are read whatever version the header names, so that two versions recognise each other.
Readers of the JSON bodies ignore keys that they do not know.
"""

import json
import math
import struct
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lockstep.errors import TEXT_LIMIT, FrameError, one_line
from lockstep.messages import (
    MAX_ROBOTS,
    MAX_ROWS,
    PLAIN,
    VERSION,
    Abort,
    Ack,
    Actions,
    Expect,
    Failure,
    Flag,
    Hello,
    Layout,
    Message,
    Payload,
    Rejection,
    Restore,
    Step,
    Weights,
    Welcome,
)
from lockstep.wire_format import (
    ABORT,
    ACK,
    ACTIONS,
    BODY_LIMITS,
    HEADER,
    MAGIC,
    MOST_WINDOWS,
    RESTORE,
    STEP,
    WEIGHTS,
    Kind,
    frame_size,
)

_STEP_FRAME = struct.Struct("<4sBBHIQIBxH")
_ACTIONS_FRAME = struct.Struct("<4sBBHIQI")
_FLAGS = int(Flag.OUTCOME | Flag.ARRIVED | Flag.DRIVING)
_WANTS = tuple(Expect)
_DIMENSIONS = {False: (2, 3), True: (1, 2)}
"""Of plain and of packed weights."""


def step_frame(tick: int, window: int, expect: Expect, records: bytes, count: int) -> bytes:
    """The frame of a `Step`, from the bytes of its so many records.

    Raises:
        FrameError: tick or window does not fit its field.
    """
    try:
        head = _STEP_FRAME.pack(
            MAGIC, VERSION, Kind.STEP, 0, STEP.size + len(records), tick, window, expect, count
        )
    except struct.error as error:
        raise FrameError(f"tick {tick} or window {window} is out of range") from error
    return head + records


def encode(message: Message) -> bytes:
    """A message as one frame.

    Raises:
        FrameError: a value does not fit its field.
    """
    try:
        return _ENCODERS[type(message)](message)
    except struct.error as error:
        raise FrameError(f"{type(message).__name__} does not fit its frame: {error}") from error


def _framed(kind: Kind, *parts: bytes | memoryview) -> bytes:
    """A frame whose body is these parts, one behind the other."""
    length = sum(memoryview(part).nbytes for part in parts)
    if length > BODY_LIMITS[kind]:
        raise FrameError(f"a {kind.name} frame of {length} bytes, of at most {BODY_LIMITS[kind]}")
    return b"".join((HEADER.pack(MAGIC, VERSION, kind, 0, length), *parts))


def _encode_step(step: Step) -> bytes:
    records = np.ascontiguousarray(step.updates)
    return step_frame(step.tick, step.window, step.expect, records.tobytes(), len(records))


def _encode_actions(message: Actions) -> bytes:
    actions = np.ascontiguousarray(message.actions, "<i4")
    return _ACTIONS_FRAME.pack(*_actions_head(message.tick, len(actions))) + actions.tobytes()


def _encode_weights(message: Weights) -> bytes:
    packed = message.weights.dtype == np.uint8
    weights, ndim, dims = _sized(message.weights, packed=packed)
    head = WEIGHTS.pack(message.window, ndim, packed, *dims)
    return _framed(Kind.WEIGHTS, head, weights.data)


def _encode_restore(restore: Restore) -> bytes:
    if restore.model is None:
        return _framed(Kind.RESTORE, RESTORE.pack(restore.number, restore.window, 0, 0, 0, 0))
    model, ndim, dims = _sized(restore.model, packed=False)
    head = RESTORE.pack(restore.number, restore.window, ndim, *dims)
    return _framed(Kind.RESTORE, head, model.data)


def _sized(weights: Payload, *, packed: bool) -> tuple[Payload, int, tuple[int, ...]]:
    """Weights as they travel, the number of their dimensions, and three sizes: 0 for none."""
    weights = np.ascontiguousarray(weights, "u1" if packed else "<f4")
    if weights.ndim not in _DIMENSIONS[packed] or 0 in weights.shape:
        raise FrameError(f"weights of shape {weights.shape}")
    return weights, weights.ndim, weights.shape + (0,) * (3 - weights.ndim)


def _encode_ack(ack: Ack) -> bytes:
    windows = ack.windows[-MOST_WINDOWS:]
    head = ACK.pack(ack.number, len(windows))
    return _framed(Kind.ACK, head, struct.pack(f"<{len(windows)}I", *windows))


_ENCODERS: dict[type, Callable[[Any], bytes]] = {
    Step: _encode_step,
    Actions: _encode_actions,
    Weights: _encode_weights,
    Hello: lambda m: _framed(Kind.HELLO, json.dumps(asdict(m)).encode()),
    Welcome: lambda m: _framed(Kind.WELCOME, json.dumps(asdict(m)).encode()),
    Restore: _encode_restore,
    Ack: _encode_ack,
    Abort: lambda m: _framed(Kind.ABORT, ABORT.pack(m.number)),
    Rejection: lambda m: _framed(Kind.REFUSED, one_line(m.reason).encode()),
    Failure: lambda m: _framed(Kind.FAILURE, one_line(m.reason).encode()),
}


def _actions_head(tick: int, count: int) -> tuple[bytes, int, int, int, int, int, int]:
    """What stands before so many actions."""
    return MAGIC, VERSION, Kind.ACTIONS, 0, ACTIONS.size + 4 * count, tick, count


def actions_in(frame: memoryview, tick: int, count: int) -> NDArray[np.int32]:
    """The actions in a frame that must be the answer to one step.

    Raises:
        FrameError: it is any other frame.
    """
    head = _ACTIONS_FRAME.unpack_from(frame) if len(frame) >= _ACTIONS_FRAME.size else ()
    if head == _actions_head(tick, count):
        return np.frombuffer(frame, "<i4", count, _ACTIONS_FRAME.size)
    message = decode(frame)
    if not isinstance(message, Actions) or message.tick != tick:
        raise FrameError(f"{type(message).__name__} where actions of tick {tick} are due")
    raise FrameError(f"{len(message.actions)} actions where {count} are due")


def decode(frame: memoryview | bytes | bytearray, layout: Layout = PLAIN) -> Message:
    """The message in a whole frame; its arrays are views of the frame.

    Args:
        frame: header and body.
        layout: of a `Step`'s records.

    Raises:
        FrameError: anything about the frame is not as it must be.
    """
    view = memoryview(frame)
    if len(view) < HEADER.size:
        raise FrameError(f"a frame of {len(view)} bytes is shorter than its header")
    if frame_size(view, len(view)) != len(view):
        raise FrameError("a frame's length is not what its header says")
    try:
        body = view[HEADER.size :]
        return _decode_step(body, layout) if view[5] == Kind.STEP else _DECODERS[view[5]](body)
    except (struct.error, ValueError, RecursionError) as error:
        raise FrameError(f"malformed {Kind(view[5]).name} frame: {one_line(error, 200)}") from error


def _decode_step(body: memoryview, layout: Layout) -> Step:
    tick, window, expect, count = STEP.unpack_from(body)
    if expect >= len(_WANTS) or not 1 <= count <= MAX_ROWS:
        raise ValueError("what it wants or its number of records is out of range")
    size = layout.record.itemsize
    if len(body) != STEP.size + count * size:
        raise ValueError(f"{len(body)} bytes are not {count} records")
    if max(body[STEP.size :: size]) > _FLAGS or any(body[STEP.size + 1 :: size]):
        raise ValueError("unknown flags")
    records = np.frombuffer(body, layout.record, count, STEP.size)
    return Step(tick, window, _WANTS[expect], records)


def _decode_actions(body: memoryview) -> Actions:
    tick, count = ACTIONS.unpack_from(body)
    if not 1 <= count <= MAX_ROWS or len(body) != ACTIONS.size + 4 * count:
        raise ValueError(f"{len(body)} bytes are not {count} actions")
    return Actions(tick, np.frombuffer(body, "<i4", count, ACTIONS.size))


def _decode_weights(body: memoryview) -> Weights:
    window, ndim, packed, *dims = WEIGHTS.unpack_from(body)
    if packed not in (0, 1):
        raise ValueError("an unknown kind of numbers")
    return Weights(window, _array(body, WEIGHTS.size, ndim, dims, packed=packed == 1))


def _array(body: memoryview, offset: int, ndim: int, dims: list[int], *, packed: bool) -> Payload:
    """The weights behind the head of a body."""
    if ndim not in _DIMENSIONS[packed] or 0 in dims[:ndim] or any(dims[ndim:]):
        raise ValueError(f"{ndim} dimensions {dims}")
    kind = np.dtype("u1" if packed else "<f4")
    if len(body) != offset + kind.itemsize * math.prod(dims[:ndim]):
        raise ValueError(f"{len(body)} bytes are not weights of shape {dims[:ndim]}")
    return np.frombuffer(body, kind, offset=offset).reshape(dims[:ndim])


def _decode_restore(body: memoryview) -> Restore:
    number, window, ndim, *dims = RESTORE.unpack_from(body)
    if ndim:
        return Restore(number, window, _array(body, RESTORE.size, ndim, dims, packed=False))
    if any(dims) or len(body) != RESTORE.size:
        raise ValueError(f"{len(body)} bytes where no model is")
    return Restore(number, window, None)


def _decode_ack(body: memoryview) -> Ack:
    number, count = ACK.unpack_from(body)
    return Ack(number, struct.unpack(f"<{count}I", body[ACK.size :]))


def _number(value: object, limit: int) -> int:
    if type(value) is not int or not 0 <= value < limit:
        raise ValueError("a number is missing or out of range")
    return value


def _text(value: object, limit: int) -> str:
    if not isinstance(value, str) or len(value) > limit or not value.isprintable():
        raise ValueError("a text is missing, too long or not printable")
    return value


def _many(value: object) -> list[object]:
    if not isinstance(value, list) or not 1 <= len(value) <= MAX_ROBOTS:
        raise ValueError("a list is missing, empty or too long")
    return value


def _fields(body: memoryview) -> dict[str, object]:
    fields: object = json.loads(bytes(body))
    if not isinstance(fields, dict):
        raise ValueError("no JSON object")
    return fields


def _decode_hello(body: memoryview) -> Hello:
    fields = _fields(body)
    return Hello(
        version=_number(fields.get("version"), 2**16),
        fingerprint=_text(fields.get("fingerprint"), TEXT_LIMIT),
        robots=[_number(robot, MAX_ROBOTS) for robot in _many(fields.get("robots"))],
        tokens=[_text(token, 256) for token in _many(fields.get("tokens"))],
    )


_DECODERS: dict[int, Callable[[memoryview], Message]] = {
    Kind.HELLO: _decode_hello,
    Kind.WELCOME: lambda body: Welcome(_number(_fields(body).get("version"), 2**16)),
    Kind.REFUSED: lambda body: Rejection(one_line(str(body, "utf-8"))),
    Kind.FAILURE: lambda body: Failure(one_line(str(body, "utf-8"))),
    Kind.ACTIONS: _decode_actions,
    Kind.WEIGHTS: _decode_weights,
    Kind.RESTORE: _decode_restore,
    Kind.ACK: _decode_ack,
    Kind.ABORT: lambda body: Abort(*ABORT.unpack(body)),
}
