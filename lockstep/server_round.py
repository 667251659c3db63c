"""One round's conversation with its clients, from the server's side.

Only the thread that drives the run touches this. All connections stay registered with one poll
object, so that a wait for any client notices at once when any other goes away.
"""

import contextlib
import logging
import select
import time
from collections.abc import Callable, Mapping, Sequence
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from lockstep.acceptor import Acceptor, RoundCredentials
from lockstep.client_slots import ClientSlot
from lockstep.errors import FrameError, LinkTimeout, RobotFailed, RobotLost, described, named
from lockstep.frame_stream import FrameStream
from lockstep.frames import decode, encode
from lockstep.interface import ProtocolState
from lockstep.messages import Abort, Ack, Failure, Restore, of_block
from lockstep.wire_format import Kind

log = logging.getLogger(__name__)


class ServerRound:
    """A Flower round on the link: a slot for each client, and the frames both ways."""

    def __init__(
        self,
        admission: RoundCredentials,
        slots: Sequence[ClientSlot],
        acceptor: Acceptor,
        timeout_s: float,
    ) -> None:
        """A round in which all slots, one for each block, are free.

        Arrivals under other terms than `admission` are turned away; an answer is waited for
        `timeout_s` seconds at most.
        """
        self.slots = {slot.block: slot for slot in slots}
        self.protocol = ProtocolState()
        self._admission, self._timeout_s = admission, timeout_s
        self._accepted, self._wakeup = acceptor.accepted, acceptor.wakeup
        self._slot_of: dict[int, ClientSlot] = {}
        self._poll = select.poll()
        self._poll.register(self._wakeup, select.POLLIN)
        self._filling = True
        self._orders = 0

    def fill(self, deadline_s: float, poll: Callable[[], None] | None) -> None:
        """Wait until every slot is taken, calling `poll` at least five times a second."""
        deadline = time.monotonic() + deadline_s
        self._filling = True
        for slot in self.slots.values():  # whoever is here answers what no longer counts
            slot.stale = slot.stream is not None
        while True:
            self._admit()
            free = self.free()
            if not free:
                self._filling = False
                return
            if poll is not None:
                poll()
            rest = deadline - time.monotonic()
            if rest <= 0:
                raise LinkTimeout(f"{_all_named(free)} did not connect within {deadline_s:g} s")
            for slot in self._ready(min(rest, 0.2)):
                self._reply(slot)

    def free(self) -> list[ClientSlot]:
        """The slots that nobody holds."""
        return [slot for slot in self.slots.values() if slot.stream is None]

    def renew(self, block: tuple[int, ...], tokens: Mapping[int, str]) -> None:
        """Give a slot up and let in only who has these tokens: whoever had it is out."""
        self._admission.tokens.update({robot: tokens[robot] for robot in block})
        self._drop(self.slots[block])

    def begin(self, window: int, model: NDArray[np.float32] | None) -> None:
        """Send all clients to a window, and wait until they are there."""

        def restore(number: int, slot: ClientSlot) -> Restore:
            own = None if model is None else of_block(model, slot.robots)
            return Restore(number, window, own)

        self._order(restore)

    def halt(self) -> list[int]:
        """Make all clients drop what is under way; returns the checkpoints that all have."""
        self._order(lambda number, slot: Abort(number))
        return sorted(frozenset.intersection(*(slot.windows for slot in self.slots.values())))

    def _order(self, order: Callable[[int, ClientSlot], Abort | Restore]) -> None:
        """Send clients what ends all that is under way; keeps what their `Ack` say."""
        self.protocol = ProtocolState()
        self._orders += 1
        for slot in self.slots.values():
            slot.stale = True
            self.send(slot, encode(order(self._orders, slot)), awaited=True)

        def accept(slot: ClientSlot, frame: memoryview) -> None:
            ack = decode(frame)
            assert isinstance(ack, Ack)
            slot.windows = frozenset(ack.windows)

        self.gather(accept)

    def send(self, slot: ClientSlot, frame: bytes, awaited: bool) -> None:
        """Send a frame to a client; `awaited` says whether an answer is due."""
        if self._accepted:
            self._admit()
        slot.awaited = False
        stream = slot.stream
        if stream is None:
            raise RobotLost(slot.block, str(self.protocol), "it is not connected")
        try:
            stream.send(frame, self._timeout_s)
        except OSError as error:
            self._recover(slot, stream, error)
        slot.stats.bytes_sent += len(frame)
        slot.stats.frames_sent += 1
        slot.awaited = awaited

    def gather(self, accept: Callable[[ClientSlot, memoryview], None]) -> None:
        """Take one answer from each client, in whatever order they come.

        Args:
            accept: takes the frame of an answer, or raises FrameError if it is not the right one.
        """
        start = time.perf_counter()
        asked = [slot for slot in self.slots.values() if slot.awaited]
        awaited = list(asked)
        while awaited:
            rest = start + self._timeout_s - time.perf_counter()
            if rest <= 0:
                for slot in awaited:
                    self._drop(slot)
                raise LinkTimeout(
                    f"{_all_named(awaited)} did not answer within {self._timeout_s:g} s, "
                    f"{self.protocol}"
                )
            for slot in self._ready(rest):
                frame = self._reply(slot)
                if frame is None:
                    continue
                try:
                    accept(slot, frame)
                except FrameError as error:
                    self._lose(slot, str(error))
                slot.awaited = False
                awaited.remove(slot)
                took_s = time.perf_counter() - start
                slot.stats.waited_s += took_s
        for slot in asked:
            slot.stats.gathered_s += took_s

    def part(self, reason: str) -> None:
        """Close all connections, after a last frame with the reason."""
        for slot in self.slots.values():
            if slot.stream is not None:
                slot.stream.finish(encode(Failure(reason)), 0.0)
                slot.stream = None

    def _ready(self, wait_s: float) -> list[ClientSlot]:
        """Wait for the slots that have something to read, and let arrivals in on the way."""
        ready = []
        for fd, _ in self._poll.poll(wait_s * 1000):
            slot = self._slot_of.get(fd)
            if slot is not None:
                ready.append(slot)
            else:
                self._admit()
        return ready

    def _reply(self, slot: ClientSlot) -> memoryview | None:
        """The frame that a client has sent; None if it is not complete yet."""
        stream = slot.stream
        if stream is None:
            return None
        try:
            frame = stream.receive()
            while frame is not None and slot.stale and not self._is_current(slot, frame):
                frame = stream.receive()
            if frame is None:
                return None
            if frame[5] == Kind.FAILURE:
                self._fail(slot, frame)
            if stream.surplus or not slot.awaited:
                raise FrameError("a frame out of turn")
        except FrameError as error:
            self._lose(slot, str(error))
        except (OSError, EOFError) as error:
            self._recover(slot, stream, error)
            return None
        slot.stats.bytes_received += len(frame)
        slot.stats.frames_received += 1
        return frame

    def _is_current(self, slot: ClientSlot, frame: memoryview) -> bool:
        """Whether a frame is the last order's `Ack`, or a failure: all before it is dropped."""
        if frame[5] == Kind.FAILURE:
            return True
        message = decode(frame)
        slot.stale = not (isinstance(message, Ack) and message.number == self._orders)
        return not slot.stale

    def _recover(self, slot: ClientSlot, stream: FrameStream, error: OSError | EOFError) -> None:
        """Go on if another connection has taken the slot; else say how the robot was lost."""
        self._admit()
        if slot.stream is not stream:
            return
        with contextlib.suppress(OSError, EOFError, FrameError):
            frame = stream.receive()
            if frame is not None and frame[5] == Kind.FAILURE:
                self._fail(slot, frame)
        self._lose(slot, str(error) if isinstance(error, EOFError) else described(error))

    def _admit(self) -> None:
        """Give the arrivals their slots; whoever sat there before has to go.

        Raises:
            RobotLost: one has come back in the middle of the conversation, of which it may have
                lost a part.
        """
        with contextlib.suppress(BlockingIOError):
            self._wakeup.recv(4096)
        back: ClientSlot | None = None
        while self._accepted:
            arrival = self._accepted.popleft()
            if arrival.admission is not self._admission:
                arrival.sock.close()
                continue
            slot = self.slots[arrival.block]
            if slot.stream is not None:
                log.warning("a new connection of %s replaces the old one", named(slot.block))
                self._drop(slot)
            slot.stream = FrameStream(arrival.sock, slot.limit)
            slot.awaited = slot.stale = False
            self._slot_of[slot.stream.fileno()] = slot
            self._poll.register(slot.stream, select.POLLIN)
            back = slot
        if back is not None and not self._filling:
            reason = "its connection broke, and it has come back with a new one"
            raise RobotLost(back.block, str(self.protocol), reason)

    def _fail(self, slot: ClientSlot, frame: memoryview) -> NoReturn:
        """A client has said why it stops."""
        reason = getattr(decode(frame), "reason", "")
        self._drop(slot)
        raise RobotFailed(slot.block, str(self.protocol), reason)

    def _lose(self, slot: ClientSlot, reason: str) -> NoReturn:
        log.warning("connection of %s closed %s: %s", named(slot.block), self.protocol, reason)
        self._drop(slot)
        raise RobotLost(slot.block, str(self.protocol), reason)

    def _drop(self, slot: ClientSlot) -> None:
        if slot.stream is not None:
            del self._slot_of[slot.stream.fileno()]
            self._poll.unregister(slot.stream)
            slot.stream.close()
            slot.stream = None


def _all_named(slots: Sequence[ClientSlot]) -> str:
    return named(sorted(robot for slot in slots for robot in slot.block))
