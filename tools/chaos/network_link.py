"""A cable between two network namespaces that is long and loses packets, made of two TAP devices.

For kernels without ``netem``: a process that carries Ethernet frames from one device to the other,
each after the delay, or not at all. The devices are gone when it ends, however it ends.
"""

from __future__ import annotations

import fcntl
import heapq
import os
import random
import select
import struct
import sys
import time
from contextlib import suppress

_TUNSETIFF = 0x400454CA
_IFF_TAP, _IFF_NO_PI = 0x0002, 0x1000
_FRAME_SIZE = 65536


def open_tap(name: str) -> int:
    """A new TAP device of that name; returns its descriptor.

    Raises:
        OSError: not permitted, or no such driver.
    """
    handle = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(handle, _TUNSETIFF, struct.pack("16sH", name.encode(), _IFF_TAP | _IFF_NO_PI))
    return handle


def carry(ends: tuple[int, int], delay_s: float, loss: float, rng: random.Random) -> None:
    """Carries frames both ways until the process is ended.

    Args:
        ends: descriptors of the devices.
        delay_s: one way.
        loss: probability that a frame is lost.
        rng: decides which.
    """
    other = dict(zip(ends, reversed(ends), strict=True))
    under_way: list[tuple[float, int, int, bytes]] = []
    count = 0
    while True:
        wait_s = max(0.0, under_way[0][0] - time.monotonic()) if under_way else None
        for end in select.select(ends, [], [], wait_s)[0]:
            with suppress(OSError):  # nothing there after all, or the device is down
                frame = os.read(end, _FRAME_SIZE)
                count += 1
                if rng.random() >= loss:
                    due = time.monotonic() + delay_s
                    heapq.heappush(under_way, (due, count, other[end], frame))
        now = time.monotonic()
        while under_way and under_way[0][0] <= now:
            _, _, end, frame = heapq.heappop(under_way)
            with suppress(OSError):  # the device is down: the frame is lost
                os.write(end, frame)


def main() -> None:
    """``python cable.py NAME NAME DELAY_MS LOSS_PERCENT SEED``: says `ready`, then carries."""
    first, second, delay_ms, loss_percent, seed = sys.argv[1:]
    ends = (open_tap(first), open_tap(second))
    print("ready", flush=True)
    carry(ends, float(delay_ms) / 1e3, float(loss_percent) / 100, random.Random(int(seed)))


if __name__ == "__main__":
    main()
