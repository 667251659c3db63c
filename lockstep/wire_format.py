"""The header of a frame, the kinds of frames and how long each may be."""

import math
import struct
from enum import IntEnum

from lockstep.errors import TEXT_LIMIT, FrameError
from lockstep.messages import MAX_ROWS, VERSION, Layout

MAGIC = b"RISF"
HEADER = struct.Struct("<4sBBHI")
STEP = struct.Struct("<QIBxH")
ACTIONS = struct.Struct("<QI")
WEIGHTS = struct.Struct("<IBB2xIII")
RESTORE = struct.Struct("<IIB3xIII")
ABORT = struct.Struct("<I")
ACK = struct.Struct("<IH")
MOST_WINDOWS = 256


class Kind(IntEnum):
    """What a frame holds."""

    HELLO = 1
    WELCOME = 2
    REFUSED = 3
    FAILURE = 4
    STEP = 5
    ACTIONS = 6
    WEIGHTS = 7
    RESTORE = 8
    ACK = 9
    ABORT = 10


TEXT_SIZE = HEADER.size + 4 * TEXT_LIMIT
HELLO_SIZE = 2**16
BODY_LIMITS = {
    Kind.HELLO: HELLO_SIZE - HEADER.size,
    Kind.WELCOME: 4 * TEXT_LIMIT,
    Kind.REFUSED: 4 * TEXT_LIMIT,
    Kind.FAILURE: 4 * TEXT_LIMIT,
    Kind.STEP: STEP.size + 2**26,
    Kind.ACTIONS: ACTIONS.size + MAX_ROWS * 4,
    Kind.WEIGHTS: WEIGHTS.size + 2**30,
    Kind.RESTORE: RESTORE.size + 2**30,
    Kind.ACK: ACK.size + 4 * MOST_WINDOWS,
    Kind.ABORT: ABORT.size,
}


def step_size(robots: int, layout: Layout) -> int:
    """Bytes of a step for so many robots."""
    return HEADER.size + STEP.size + robots * layout.worlds * layout.record.itemsize


def actions_size(robots: int, layout: Layout) -> int:
    """Bytes of the actions of so many robots."""
    return HEADER.size + ACTIONS.size + robots * layout.worlds * 4


def weights_size(shape: tuple[int, ...]) -> int:
    """Bytes of a frame of plain weights."""
    return HEADER.size + WEIGHTS.size + 4 * math.prod(shape)


def upload_size(robots: int, parameters: int, layout: Layout) -> int:
    """Bytes of the upload of so many robots, of P numbers each network."""
    if layout.upload:
        return HEADER.size + WEIGHTS.size + robots * layout.upload
    return weights_size((robots, 2, parameters))


def model_size(robots: int, parameters: int, layout: Layout) -> int:
    """Bytes of the longest frame that brings so many robots plain models, or a packed one."""
    longest = max(4 * robots * 2 * parameters, layout.download)
    return HEADER.size + max(WEIGHTS.size, RESTORE.size) + longest


def frame_size(head: memoryview, limit: int) -> int:
    """Bytes, at most `limit`, of the frame that begins with `head`, which holds its header.

    Raises:
        FrameError: this is no header, or the frame would be too long.
    """
    magic, version, kind, zero, length = HEADER.unpack_from(head)
    if magic != MAGIC or zero:
        raise FrameError("not a frame of the link")
    if kind not in BODY_LIMITS:
        raise FrameError(f"unknown kind of frame {kind}")
    if version != VERSION and kind not in (Kind.HELLO, Kind.REFUSED):
        raise FrameError(f"link version {version}, where {VERSION} is spoken")
    size: int = HEADER.size + length
    if length > BODY_LIMITS[kind] or size > limit:
        raise FrameError(f"a {Kind(kind).name} frame of {size} bytes, of at most {limit}")
    return size
