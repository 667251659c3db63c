"""One round's conversation with its clients, from the server's side.

Only the thread that drives the run touches this. All connections stay registered with one poll
object, so that a wait for any client notices at once when any other goes away.
"""

import contextlib
import logging
import select
import socket
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from lockstep.acceptor import AcceptedClient, RoundCredentials
from lockstep.client_slots import ClientSlot
from lockstep.errors import FrameError, LinkTimeout, RobotFailed, RobotLost, described, named
from lockstep.frame_stream import FrameStream
from lockstep.frames import decode, encode
from lockstep.interface import ProtocolState
from lockstep.messages import Abort, Ack, Failure, Restore
from lockstep.wire_format import Kind

log = logging.getLogger(__name__)


class ServerRound:
    """The seats of a round, and what goes to and fro."""

    def __init__(
        self,
        admission: RoundCredentials,
        seats: Sequence[ClientSlot],
        arrivals: deque[AcceptedClient],
        wakeup: socket.socket,
        timeout_s: float,
    ) -> None:
        """A round in which all seats are free.

        Args:
            admission: the terms of this round; arrivals under other terms are turned away.
            seats: one for each block.
            arrivals: where the door leaves those whom it has let in.
            wakeup: readable when there are new arrivals.
            timeout_s: the longest wait for an answer.
        """
        self.seats = {seat.block: seat for seat in seats}
        self.turn = ProtocolState()
        self._admission, self._arrivals, self._wakeup = admission, arrivals, wakeup
        self._timeout_s = timeout_s
        self._seat_of: dict[int, ClientSlot] = {}
        self._poll = select.poll()
        self._poll.register(wakeup, select.POLLIN)
        self._filling = True
        self._orders = 0

    def fill(self, deadline_s: float, poll: Callable[[], None] | None) -> None:
        """Wait until every seat is taken, calling `poll` at least five times a second."""
        deadline = time.monotonic() + deadline_s
        self._filling = True
        for seat in self.seats.values():  # whoever is here answers what no longer counts
            seat.stale = seat.wire is not None
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
            for seat in self._ready(min(rest, 0.2)):
                self._reply(seat)

    def free(self) -> list[ClientSlot]:
        """The seats that nobody holds."""
        return [seat for seat in self.seats.values() if seat.wire is None]

    def renew(self, block: tuple[int, ...], tokens: Mapping[int, str]) -> None:
        """Give a seat up and let in only who has these tokens: whoever had it is out."""
        self._admission.tokens.update({robot: tokens[robot] for robot in block})
        self._drop(self.seats[block])

    def begin(self, window: int, model: NDArray[np.float32] | None) -> None:
        """Send all clients to a window, and wait until they are there."""
        self.turn = ProtocolState()
        self._order(Restore(self._orders + 1, window, model))

    def halt(self) -> list[int]:
        """Make all clients drop what is under way; returns the checkpoints that all have."""
        self.turn = ProtocolState()
        self._order(Abort(self._orders + 1))
        return sorted(frozenset.intersection(*(seat.windows for seat in self.seats.values())))

    def _order(self, order: Abort | Restore) -> None:
        """Send all clients an order that ends what is under way; keeps what their `Ack` say."""
        self._orders = order.number
        frame = encode(order)
        for seat in self.seats.values():
            seat.stale = True
            self.send(seat, frame, awaited=True)

        def accept(seat: ClientSlot, frame: memoryview) -> None:
            ready = decode(frame)
            assert isinstance(ready, Ack)
            seat.windows = frozenset(ready.windows)

        self.gather(accept)

    def send(self, seat: ClientSlot, frame: bytes, awaited: bool) -> None:
        """Send a frame to a client; `awaited` says whether an answer is due."""
        if self._arrivals:
            self._admit()
        seat.awaited = False
        wire = seat.wire
        if wire is None:
            raise RobotLost(seat.block, str(self.turn), "it is not connected")
        try:
            wire.send(frame, self._timeout_s)
        except OSError as error:
            self._recover(seat, wire, error)
        seat.stats.bytes_sent += len(frame)
        seat.stats.frames_sent += 1
        seat.awaited = awaited

    def gather(self, accept: Callable[[ClientSlot, memoryview], None]) -> None:
        """Take one answer from each client, in whatever order they come.

        Args:
            accept: takes the frame of an answer, or raises FrameError if it is not the right one.
        """
        start = time.perf_counter()
        asked = [seat for seat in self.seats.values() if seat.awaited]
        awaited = list(asked)
        while awaited:
            rest = start + self._timeout_s - time.perf_counter()
            if rest <= 0:
                for seat in awaited:
                    self._drop(seat)
                raise LinkTimeout(
                    f"{_all_named(awaited)} did not answer within {self._timeout_s:g} s, "
                    f"{self.turn}"
                )
            for seat in self._ready(rest):
                frame = self._reply(seat)
                if frame is None:
                    continue
                try:
                    accept(seat, frame)
                except FrameError as error:
                    self._lose(seat, str(error))
                seat.awaited = False
                awaited.remove(seat)
                took_s = time.perf_counter() - start
                seat.stats.waited_s += took_s
        for seat in asked:
            seat.stats.gathered_s += took_s

    def part(self, reason: str) -> None:
        """Close all connections, and tell those who are still there why."""
        for seat in self.seats.values():
            if seat.wire is not None:
                seat.wire.finish(encode(Failure(reason)), 0.0)
                seat.wire = None

    def _ready(self, wait_s: float) -> list[ClientSlot]:
        """Wait for the seats that have something to read, and let arrivals in on the way."""
        ready = []
        for fd, _ in self._poll.poll(wait_s * 1000):
            seat = self._seat_of.get(fd)
            if seat is not None:
                ready.append(seat)
            else:
                self._admit()
        return ready

    def _reply(self, seat: ClientSlot) -> memoryview | None:
        """The frame that a client has sent; None if it is not complete yet."""
        wire = seat.wire
        if wire is None:
            return None
        try:
            frame = wire.receive()
            while frame is not None and seat.stale and not self._is_ready(seat, frame):
                frame = wire.receive()
            if frame is None:
                return None
            if frame[5] == Kind.FAILURE:
                self._fail(seat, frame)
            if wire.surplus or not seat.awaited:
                raise FrameError("a frame out of turn")
        except FrameError as error:
            self._lose(seat, str(error))
        except (OSError, EOFError) as error:
            self._recover(seat, wire, error)
            return None
        seat.stats.bytes_received += len(frame)
        seat.stats.frames_received += 1
        return frame

    def _is_ready(self, seat: ClientSlot, frame: memoryview) -> bool:
        """Whether a client that was sent to a window is there; a failure is not waited past."""
        if frame[5] == Kind.FAILURE:
            return True
        message = decode(frame)
        seat.stale = not (isinstance(message, Ack) and message.number == self._orders)
        return not seat.stale

    def _recover(self, seat: ClientSlot, wire: FrameStream, error: OSError | EOFError) -> None:
        """Go on if another connection has taken the seat; else say how the robot was lost."""
        self._admit()
        if seat.wire is not wire:
            return
        with contextlib.suppress(OSError, EOFError, FrameError):
            frame = wire.receive()
            if frame is not None and frame[5] == Kind.FAILURE:
                self._fail(seat, frame)
        self._lose(seat, str(error) if isinstance(error, EOFError) else described(error))

    def _admit(self) -> None:
        """Give the arrivals their seats; whoever sat there before has to go.

        Raises:
            RobotLost: one has come back in the middle of the conversation, of which it may have
                lost a part.
        """
        with contextlib.suppress(BlockingIOError):
            self._wakeup.recv(4096)
        back: ClientSlot | None = None
        while self._arrivals:
            arrival = self._arrivals.popleft()
            if arrival.admission is not self._admission:
                arrival.sock.close()
                continue
            seat = self.seats[arrival.block]
            if seat.wire is not None:
                log.warning("a new connection of %s replaces the old one", named(seat.block))
                self._drop(seat)
            seat.wire = FrameStream(arrival.sock, seat.limit)
            seat.awaited = seat.stale = False
            self._seat_of[seat.wire.fileno()] = seat
            self._poll.register(seat.wire, select.POLLIN)
            back = seat
        if back is not None and not self._filling:
            reason = "its connection broke, and it has come back with a new one"
            raise RobotLost(back.block, str(self.turn), reason)

    def _fail(self, seat: ClientSlot, frame: memoryview) -> NoReturn:
        """A client has said why it stops."""
        words = decode(frame)
        self._drop(seat)
        raise RobotFailed(seat.block, str(self.turn), getattr(words, "reason", ""))

    def _lose(self, seat: ClientSlot, reason: str) -> NoReturn:
        """Close a client's connection, and say why the round cannot go on."""
        log.warning("connection of %s closed %s: %s", named(seat.block), self.turn, reason)
        self._drop(seat)
        raise RobotLost(seat.block, str(self.turn), reason)

    def _drop(self, seat: ClientSlot) -> None:
        """Free a seat."""
        if seat.wire is not None:
            del self._seat_of[seat.wire.fileno()]
            self._poll.unregister(seat.wire)
            seat.wire.close()
            seat.wire = None


def _all_named(seats: Sequence[ClientSlot]) -> str:
    return named(sorted(robot for seat in seats for robot in seat.block))
