"""What an exchange with other processes costs when nobody does anything but exchange."""

from __future__ import annotations

import multiprocessing
import select
import socket
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from multiprocessing.process import BaseProcess

PATIENCE_S = 120.0


class Bare:
    """As many processes as there are robots that answer a frame with a frame, over TCP.

    Args:
        ends: the sockets to them.
        sizes: bytes of a frame to them, and of their answer.
    """

    def __init__(self, ends: Sequence[socket.socket], sizes: tuple[int, int]) -> None:
        self._sizes = sizes
        self._ends = {end.fileno(): end for end in ends}
        self._poll = select.poll()
        for end in ends:
            self._poll.register(end, select.POLLIN)

    def __call__(self, steps: int) -> None:
        """Makes some exchanges."""
        frame, size = bytes(self._sizes[0]), self._sizes[1]
        for _ in range(steps):
            for end in self._ends.values():
                end.sendall(frame)
            left = len(self._ends)
            while left:
                for descriptor, _ in self._poll.poll():
                    self._ends[descriptor].recv(size, socket.MSG_WAITALL)
                    left -= 1


def _join(processes: list[BaseProcess]) -> None:
    for process in processes:
        process.join(PATIENCE_S)


def echo(address: tuple[str, int], sizes: tuple[int, int]) -> None:
    """A process that answers each frame until the connection ends."""
    with socket.create_connection(address) as end:
        end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        answer = bytes(sizes[1])
        while end.recv(sizes[0], socket.MSG_WAITALL):
            end.sendall(answer)


@contextmanager
def echoing(count: int, sizes: tuple[int, int]) -> Iterator[Bare]:
    """Starts so many of these processes; all have ended on leaving."""
    context = multiprocessing.get_context("spawn")
    with ExitStack() as stack, socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(PATIENCE_S)
        started: list[BaseProcess] = []
        stack.callback(lambda: _join(started))
        ends = []
        for _ in range(count):
            address = listener.getsockname()
            started.append(context.Process(target=echo, args=(address, sizes), daemon=True))
            started[-1].start()
            end = stack.enter_context(listener.accept()[0])
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            ends.append(end)
        yield Bare(ends, sizes)
