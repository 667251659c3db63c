"""Looks for frames that break the link, guided by coverage; not part of the test suite.

    pip install atheris
    python tools/fuzzing/fuzz_frames.py {codec,wire,server,client} CORPUS -max_total_time=600

`codec` and `wire` never leave the process; `server` and `client` talk over real sockets. An input
is a finding if anything but an error of the link comes out. Each input that reaches new code is
kept in the folder CORPUS, which begins with a frame of every kind. Options are libFuzzer's.
"""

import contextlib
import logging
import socket
import sys
from pathlib import Path
from unittest import mock

import atheris

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "lockstep")]
with atheris.instrument_imports(include=["lockstep", "json"]):
    import json.decoder
    import json.scanner

    import numpy as np
    from link_helpers import PARAMETERS, SHAPE, WIDE, Recorder, token, updates

    from lockstep.acceptor import RoundCredentials
    from lockstep.client import serve
    from lockstep.errors import FrameError, LinkError, RobotFailed, RobotLost
    from lockstep.frame_stream import FrameStream
    from lockstep.frames import decode, encode
    from lockstep.messages import PLAIN, VERSION, Actions, Expect, Hello, Step, Weights, Welcome
    from lockstep.server import LinkServer
    from lockstep.wire_format import HEADER, MAGIC, Kind

# The C scanner and decoder show no coverage: let Python's own read the JSON.
json.decoder.scanstring = json.decoder.py_scanstring
json.scanner.make_scanner = json.decoder.scanner.make_scanner = json.scanner.py_make_scanner
json._default_decoder = json.JSONDecoder()

ADMISSION = RoundCredentials("v1", ((0,), (1, 2)), {robot: token(robot) for robot in range(3)})
LAYOUTS = (PLAIN, WIDE)
TIMEOUT_S = 5.0


def codec(data):
    """One frame: refused, or the same again once encoded and decoded."""
    for layout in LAYOUTS:
        try:
            message = decode(data, layout)
        except FrameError:
            continue
        if isinstance(message, Hello):
            reason = ADMISSION.refusal(message)
            assert reason is None or "secret" not in reason
        frame = encode(message)
        assert encode(decode(frame, layout)) == frame


class _Trickle:
    """A socket that has nothing every other time, and else a portion which the input chooses."""

    def __init__(self, data):
        self._data, self._portion, self._ready = data, 1, False

    def recv_into(self, view):
        self._ready = not self._ready
        if not self._ready:
            raise BlockingIOError
        self._portion = 1 + (self._portion * 7 + sum(self._data[:1])) % 97
        got = self._data[: min(self._portion, len(view))]
        view[: len(got)] = got
        self._data = self._data[len(got) :]
        return len(got)


def wire(data):
    """A stream of frames in pieces: each is what `decode` makes of it, until the first bad one."""
    reader = FrameStream(_Trickle(data), 2**16)
    with contextlib.suppress(FrameError, EOFError):
        while True:
            frame = reader.receive()
            if frame is not None:
                codec(bytes(frame))


def _pair():
    """Both ends of a TCP connection on loopback."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        near = socket.create_connection(listener.getsockname(), TIMEOUT_S)
        far, _ = listener.accept()
    far.settimeout(TIMEOUT_S)
    return near, far


def client(data):
    """A server says some sound frames and then whatever it likes."""
    mode = data[0] if data else 0
    layout = LAYOUTS[mode // 5 % 2]
    records = np.zeros(layout.worlds, layout.record)
    model = np.zeros((2, PARAMETERS), np.float32)
    sound = [
        Welcome(),
        Step(0, 1, Expect.ACTIONS, records),
        Step(1, 1, Expect.WEIGHTS, records),
        Weights(1, model),
    ]
    count = mode % (len(sound) + 1)
    near, far = _pair()
    with near, far, mock.patch("socket.create_connection", return_value=near):
        far.sendall(b"".join(map(encode, sound[:count])) + data[1:])
        far.shutdown(socket.SHUT_WR)
        with contextlib.suppress(LinkError):
            serve(
                ("127.0.0.1", 1),
                [0],
                [token(0)],
                Recorder((0,)),
                fingerprint="v1",
                timeout_s=TIMEOUT_S,
                n_parameters=PARAMETERS,
                layout=layout,
            )


class _Server:
    """A live server; the first byte says whether the peer is admitted and what is asked of it."""

    def __init__(self):
        self._server = LinkServer(fingerprint="v1", timeout_s=TIMEOUT_S, handshake_s=TIMEOUT_S)
        self._hello = encode(Hello(VERSION, "v1", [0], [token(0)]))
        self._welcome = encode(Welcome())

    def __call__(self, data):
        mode, data = data[0] if data else 0, data[1:]
        self._server.admit([(0,)], {0: token(0)}, SHAPE)
        with socket.create_connection(self._server.address, TIMEOUT_S) as sock:
            if mode & 1:
                with contextlib.suppress(OSError):
                    sock.sendall(data)
                    sock.shutdown(socket.SHUT_WR)
                    while sock.recv(65536) not in (b"", self._welcome):
                        pass
                return
            sock.sendall(self._hello)
            self._server.wait_connected(TIMEOUT_S)
            sock.sendall(data)
            sock.shutdown(socket.SHUT_WR)
            expect = Expect.WEIGHTS if mode & 2 else Expect.ACTIONS
            with contextlib.suppress(RobotLost, RobotFailed):
                self._server.send_step(0, 1, expect, updates(1, 0))
                _ = self._server.upload(1) if mode & 2 else self._server.actions(0)


def seeds():
    """Something of every kind of frame to begin with, sound or nearly so."""
    for kind in Kind:
        for body in (b"", b'{"version": 1}', bytes(12), bytes(64)):
            yield HEADER.pack(MAGIC, VERSION, kind, 0, len(body)) + body
    yield encode(Hello(VERSION, "v1", [0], [token(0)]))
    yield encode(Hello(VERSION, "v1", [1, 2], [token(1), token(2)]))
    for layout in LAYOUTS:
        yield encode(Step(1, 1, Expect.ACTIONS, updates(1, 0, layout)))
    yield encode(Actions(0, np.array([3], np.int32)))
    yield encode(Weights(1, np.zeros((1, *SHAPE), np.float32)))
    yield encode(Weights(1, np.zeros(SHAPE, np.float32)))
    yield encode(Weights(1, np.zeros((1, 40), np.uint8)))  # packed


def main():
    """Runs one of the targets until libFuzzer stops."""
    targets = {"codec": lambda: codec, "wire": lambda: wire, "client": lambda: client}
    targets["server"] = _Server
    if len(sys.argv) < 3 or sys.argv[1] not in targets:
        raise SystemExit(__doc__)
    logging.disable(logging.CRITICAL)
    name, corpus = sys.argv.pop(1), Path(sys.argv[1])
    corpus.mkdir(parents=True, exist_ok=True)
    for number, frame in enumerate(seeds()):
        for mode in range(10) if name in ("client", "server") else [None]:
            prefix = b"" if mode is None else bytes([mode])
            (corpus / f"seed-{number}-{mode}").write_bytes(prefix + frame)
    target = targets[name]()
    atheris.Setup(sys.argv, target)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
