"""Handlers, clients on threads and a coordinator in small, for the tests of the link."""

import socket
import threading

import numpy as np

from lockstep.client import serve
from lockstep.frame_stream import FrameStream
from lockstep.frames import encode
from lockstep.messages import PLAIN, VERSION, Expect, Flag, Hello, Layout
from lockstep.wire_format import TEXT_SIZE

PARAMETERS = 11
SHAPE = (2, PARAMETERS)
PATIENCE_S = 60.0
WIDE = Layout(worlds=3, broadcast=2, credit=True)
"""Records with all that they may carry."""


def token(robot):
    return f"secret-{robot}"


class Recorder:
    """Answers with what it was told, and remembers every call."""

    def __init__(self, block, fail_at=None):
        self.block = block
        self.fail_at = fail_at
        self.calls = []
        self.kept_windows = []
        self.model = np.zeros(SHAPE, np.float32)

    def step(self, step):
        self.calls.append(("step", step.tick, step.window, step.expect, step.updates.tobytes()))
        self.kept = step.updates
        if step.tick == self.fail_at:
            raise ValueError("the replay\nis full")
        if step.expect is not Expect.ACTIONS:
            return None
        driving = step.updates["flags"] & Flag.DRIVING
        return np.where(driving, step.updates["cell"] % 24, -1).astype(np.int32)

    def upload(self):
        self.calls.append(("upload",))
        ranks = np.array(self.block, np.float32)[:, None, None]
        return np.broadcast_to(self.model + 1 + ranks, (len(self.block), *SHAPE)).astype("f4")

    def download(self, window, weights):
        self.calls.append(("download", window, weights.tobytes()))
        self.model = weights

    def windows(self):
        return self.kept_windows

    def begin(self, window, model):
        self.calls.append(("begin", window, None if model is None else model.tobytes()))
        self.model = np.zeros(SHAPE, np.float32) if model is None else model


class Client:
    """`serve` on a thread; what it raises is kept in `error`."""

    def __init__(self, server, handler, **changes):
        robots = list(changes.pop("robots", handler.block))
        tokens = changes.pop("tokens", [token(robot) for robot in robots])
        options = {"fingerprint": "v1", "timeout_s": PATIENCE_S, "n_parameters": PARAMETERS}
        self.handler, self.error = handler, None
        self._arguments = (server.address, robots, tokens, handler), options | changes
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        positional, named = self._arguments
        try:
            serve(*positional, **named)
        except BaseException as error:
            self.error = error

    def join(self):
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()
        return self.error


class RawClient:
    """A client that a test drives by hand, frame by frame."""

    def __init__(self, server):
        self.sock = socket.create_connection(server.address, timeout=PATIENCE_S)
        self.stream = FrameStream(self.sock, 2**20)

    def send(self, message):
        self.sock.sendall(message if isinstance(message, bytes) else encode(message))
        return self

    def hello(self, block, **changes):
        fields = {
            "version": VERSION,
            "fingerprint": "v1",
            "robots": list(block),
            "tokens": [token(robot) for robot in block],
        }
        return self.send(Hello(**fields | changes))

    def receive(self):
        frame = self.stream.receive()
        return bytes(frame)

    def at_end(self):
        """True once the server has closed the connection; TimeoutError if it does not."""
        try:
            while self.sock.recv(TEXT_SIZE):
                pass
        except ConnectionError:
            pass
        return True

    def close(self):
        self.sock.close()


def updates(count, tick, layout=PLAIN):
    """Records that differ in every field, with one robot in five not driving in a world."""
    rng, rows = np.random.default_rng(tick), count * layout.worlds
    result = np.frombuffer(rng.bytes(rows * layout.record.itemsize), layout.record).copy()
    result["cell"] = rng.integers(3600, size=rows)
    result["flags"] = np.where(rng.random(rows) < 0.8, Flag.DRIVING | Flag.OUTCOME, Flag.ARRIVED)
    return result


def ask(fleet, robots, tick):
    """One tick."""
    fleet.send_step(tick, 1, Expect.ACTIONS, updates(robots, tick))
    return fleet.actions(tick)


def drive(fleet, robots, ticks=12, every=4, layout=PLAIN):
    """A run in small: windows of `every` ticks, the last of which ends with a farewell."""
    seen = []
    window = 1

    def send(tick, expect):
        fleet.send_step(tick, window, expect, updates(robots, tick, layout))

    send(0, Expect.ACTIONS)
    for tick in range(1, ticks + 1):
        seen.append(fleet.actions(tick - 1))
        if tick == ticks:
            send(tick, Expect.END_ROUND)
        elif tick % every == 0:
            send(tick, Expect.WEIGHTS)
            seen.append(fleet.upload(window))
            if window != 1:  # the first time nothing comes back, as with the strategy `none`
                fleet.download(window, seen[-1].mean(axis=0, dtype=np.float32))
            window += 1
            send(tick, Expect.ACTIONS)
        else:
            send(tick, Expect.ACTIONS)
    return seen
