"""What travels on the link.

| message | from | carries | answer |
|---|---|---|---|
| `Hello` | client | version, fingerprint, robots, a token for each | `Welcome` or `Rejection` |
| `Abort` | server | nothing: whatever was under way is over | `Ack` |
| `Restore` | server | a window to go to, and its global model | `Ack` |
| `Ack` | client | the windows of which its robots have checkpoints | none |
| `Step` | server | outcome of a tick, observation of the next, what is wanted | see `Expect` |
| `Actions` | client | an action for each robot, -1 where it is not driving | the next `Step` |
| `Weights` | client | upload of each robot, see `Layout` | `Weights` or `Step` |
| `Weights` | server | download: the global model, or each robot's own | none; a `Step` follows |
| `Failure` | either | one line: why this side stops | none |

`Abort` and `Restore` may come at any time. What the client sent before them counts no more: the
server drops all up to the `Ack` that has their number.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

VERSION = 4
MAX_ROBOTS = 256
MAX_ROWS = 2**16 - 1
"""Most records in a `Step`: robots times worlds."""

UPDATE = np.dtype(
    [
        ("flags", "<u2"),
        ("outcome_cell", "<i4"),
        ("outcome_channel_db", "<f4"),
        ("rate", "<f8"),
        ("cell", "<i4"),
        ("channel_db", "<f4"),
    ]
)
"""One robot's record in a `Step`: packed, little-endian, 26 bytes."""

Payload = NDArray[Any]
"""Weights on their way: float32 where plain, uint8 where packed, see `Layout`."""


@dataclass(frozen=True)
class Layout:
    """What stands in frames: the same for all robots of a run, and known to both sides.

    Records of a `Step` are robot-major: a robot's rows, one for each world, stand side by side.
    Plain weights are float32, online then target: (n, 2, P) up, (2, P) down, or (n, 2, P) where
    each robot is given its own. Packed ones are uint8: (n, `upload`) up, (`download`,) down.

    Attributes:
        worlds: E, copies of the world in which each robot drives.
        broadcast: numbers that the access point broadcasts to each robot in a slot.
        credit: whether it also tells robots what the slot was worth.
        upload: bytes of a robot's packed weights; 0 sends plain ones.
        download: bytes of a packed global model, likewise.
    """

    worlds: int = 1
    broadcast: int = 0
    credit: bool = False
    upload: int = 0
    download: int = 0

    @cached_property
    def record(self) -> np.dtype[np.void]:
        """A record: `UPDATE`, then the credit and the broadcasts, if any."""
        if not self.broadcast and not self.credit:
            return UPDATE
        credit = [("credit", "<f8")] if self.credit else []
        names = ("outcome_broadcast", "broadcast") if self.broadcast else ()
        told = [(name, "<f4", (self.broadcast,)) for name in names]
        return np.dtype([*UPDATE.descr, *credit, *told])

    def rows_of(self, block: Sequence[int]) -> slice | NDArray[np.intp]:
        """The index that picks the rows of a block of robots: a slice where they are neighbours."""
        worlds = self.worlds
        if list(block) == list(range(block[0], block[0] + len(block))):
            return slice(block[0] * worlds, (block[0] + len(block)) * worlds)
        return (np.array(block, np.intp)[:, None] * worlds + np.arange(worlds)).ravel()


PLAIN = Layout()


class Flag(IntFlag):
    """Bits of a record's `flags`."""

    OUTCOME = 1
    """The record carries an outcome to learn from."""
    ARRIVED = 2
    """The robot arrived in that outcome."""
    DRIVING = 4
    """An action is wanted for the observation."""


class Expect(IntEnum):
    """What the server expects next."""

    ACTIONS = 0
    """An action for each robot."""
    WEIGHTS = 1
    """An upload over the link."""
    END_ROUND = 2
    """Nothing: the round ends, and the weights travel in the Flower reply."""


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The outcome of one tick and the observation of the next: rows of n robots (`Layout`)."""

    tick: int
    window: int
    expect: Expect
    updates: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Actions:
    """The answers to a step: int32, one for each of its rows, -1 where a robot is not driving."""

    tick: int
    actions: NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """Weights of a window, as `Layout` says."""

    window: int
    weights: Payload


@dataclass(frozen=True, slots=True)
class Hello:
    """A client's first words."""

    version: int
    fingerprint: str
    robots: list[int]
    tokens: list[str] = field(repr=False)  # no log may hold them


@dataclass(frozen=True, slots=True)
class Welcome:
    """The client is in."""

    version: int = VERSION


@dataclass(frozen=True, slots=True)
class Abort:
    """Drop what is under way, and say which checkpoints there are."""

    number: int


@dataclass(frozen=True, slots=True, eq=False)
class Restore:
    """Go to the state after a window, 0 being the run's start; then take a model, if any.

    `model`: plain weights, or None where each robot keeps its own.
    """

    number: int
    window: int
    model: NDArray[np.float32] | None


@dataclass(frozen=True, slots=True)
class Ack:
    """The client has done what the `Abort` or `Restore` of this number says."""

    number: int
    windows: tuple[int, ...] = ()
    """After an `Abort`: windows of which all its robots have a checkpoint, whole and unchanged."""


@dataclass(frozen=True, slots=True)
class Rejection:
    """The client is not let in."""

    reason: str


@dataclass(frozen=True, slots=True)
class Failure:
    """Why this side stops."""

    reason: str


Message = Step | Actions | Weights | Hello | Welcome | Abort | Restore | Ack | Rejection | Failure


def robot_count(blocks: Sequence[Sequence[int]]) -> int:
    """K, where the clients' blocks hold each of the robots 0..K-1 once and none is empty.

    Raises:
        ValueError: they do not.
    """
    robots = sorted(robot for block in blocks for robot in block)
    if not all(blocks) or robots != list(range(len(robots))) or not 1 <= len(robots) <= MAX_ROBOTS:
        raise ValueError(
            f"blocks {[tuple(block) for block in blocks]} must hold each robot from 0 to K-1 once "
            f"(K at most {MAX_ROBOTS}), and none may be empty"
        )
    return len(robots)


def checked_updates(updates: np.ndarray, robots: int, layout: Layout) -> np.ndarray:
    """The records, if there is one for each robot in each world."""
    count = robots * layout.worlds
    if updates.dtype != layout.record or updates.shape != (count,):
        raise ValueError(f"updates must be UPDATE records of shape ({count},)")
    return updates


def checked_actions(actions: object, count: int) -> NDArray[np.int32]:
    """A handler's actions, if they are int32 of shape (n,)."""
    if not isinstance(actions, np.ndarray):
        raise TypeError(f"actions must be an int32 array, not {type(actions).__name__}")
    if actions.dtype != np.int32 or actions.shape != (count,):
        raise ValueError(f"actions {actions.dtype}{actions.shape} must be int32({count},)")
    return actions


def checked_upload(weights: object, robots: int, parameters: int, layout: Layout) -> Payload:
    """The weights of n robots, if they are as the layout says; they are never cast."""
    if layout.upload:
        return _checked(weights, np.uint8, (robots, layout.upload))
    return _checked(weights, np.float32, (robots, 2, parameters))


def checked_download(weights: object, robots: int, parameters: int, layout: Layout) -> Payload:
    """A global model, or each of n robots' own, if it is as the layout says."""
    if layout.download:
        return _checked(weights, np.uint8, (layout.download,))
    return checked_model(weights, robots, parameters)


def checked_model(weights: object, robots: int, parameters: int) -> NDArray[np.float32]:
    """Plain weights for all, or each of n robots' own."""
    return _checked(weights, np.float32, (2, parameters), (robots, 2, parameters))


def of_block(weights: Any, block: Sequence[int]) -> Any:
    """A copy of what a block of robots is given: what all take, or its own plain rows."""
    return weights[list(block)] if weights.ndim == 3 else weights.copy()


def _checked(weights: object, kind: type, *shapes: tuple[int, ...]) -> Payload:
    """An array, if it is of this kind and of one of these shapes."""
    if not isinstance(weights, np.ndarray):
        raise TypeError(f"weights must be a {kind.__name__} array, not {type(weights).__name__}")
    if weights.dtype != kind or weights.shape not in shapes:
        wanted = " or ".join(f"{kind.__name__}{shape}" for shape in shapes)
        raise ValueError(f"weights {weights.dtype} of shape {weights.shape} must be {wanted}")
    return weights
