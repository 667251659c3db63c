"""Hostile peers: whatever they send, nothing crashes, hangs or grows, and honest robots go on.

`tools/fuzzing/fuzz_frames.py` looks for the same with coverage as its guide.
"""

import contextlib
import gc
import logging
import os
import socket
import threading
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hostile import (
    LAYOUTS,
    MESSAGE_TYPES,
    good_conversation,
    messages_of,
    pieces,
    scripts,
    valid_frames,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from link_helpers import (
    PARAMETERS,
    PATIENCE_S,
    SHAPE,
    Client,
    RawClient,
    Recorder,
    drive,
    token,
    updates,
)

from lockstep import frames
from lockstep.acceptor import MAX_PENDING
from lockstep.errors import FrameError, LinkError, LinkTimeout, RobotFailed, RobotLost
from lockstep.frame_stream import FrameStream
from lockstep.frames import decode, encode
from lockstep.local import InProcessFleet
from lockstep.messages import PLAIN, VERSION, Actions, Expect, Hello, Weights, Welcome
from lockstep.server import LinkServer
from lockstep.tls import client_context, server_context
from lockstep.wire_format import HEADER, Kind
from server_app.certificates import run_certificate

BLOCKS = ((0,), (1, 2))
TOKENS = {robot: token(robot) for block in BLOCKS for robot in block}
run_often = settings(max_examples=25)


# --- The parser -----------------------------------------------------------------------------------


def test_the_fuzzers_know_every_kind_of_frame():
    assert set(MESSAGE_TYPES) == set(frames._ENCODERS)
    assert set(Kind) == {*frames._DECODERS, Kind.STEP}
    for message_type in MESSAGE_TYPES:
        messages_of(message_type).validate()


@given(pieces, st.sampled_from(LAYOUTS))
def test_a_frame_is_refused_or_says_the_same_when_sent_on(data, layout):
    try:
        frame = encode(decode(data, layout))
    except FrameError:
        return
    assert encode(decode(frame, layout)) == frame


@pytest.mark.parametrize("filler", [b"[", b'{"a":', b"1", b"[[],", b'"\\u00e9', b"\xff\xfe", b"{}"])
@pytest.mark.parametrize("kind", list(Kind))
def test_no_frame_makes_the_parser_take_much_more_memory_than_the_frame(kind, filler):
    body = (filler * 65536)[: 60_000 if kind is Kind.HELLO else 4000]
    frame = HEADER.pack(b"RISF", VERSION, kind, 0, len(body)) + body
    with contextlib.suppress(FrameError):
        decode(frame)
    tracemalloc.start()
    with contextlib.suppress(FrameError):
        decode(frame)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 100 * len(frame) + 20_000


@run_often
@given(st.lists(valid_frames, max_size=4), st.binary(max_size=20), st.data())
def test_a_stream_gives_whole_frames_however_they_are_cut(sent, rest, data):
    limit = 2**12
    sent = [frame for frame in sent if len(frame) <= limit]
    left = b"".join(sent) + rest
    ours, theirs = socket.socketpair()
    with ours, theirs:
        ours.setblocking(False)
        stream = FrameStream(ours, limit)
        got: list[Any] = []
        while left and len(got) < len(sent):
            cut = data.draw(st.integers(1, 200))
            theirs.sendall(left[:cut])
            left = left[cut:]
            while len(got) < len(sent) and (frame := stream.receive()) is not None:
                got.append(bytes(frame))
    assert got == sent


# --- The server -----------------------------------------------------------------------------------


def reference(blocks):
    """What an undisturbed run hears."""
    return drive(InProcessFleet([(block, Recorder(block)) for block in blocks]), 3)


UNDISTURBED = [array.tobytes() for array in reference(BLOCKS)]


@contextlib.contextmanager
def link(**options):
    """A server that is closed at the end, and none of whose threads is left."""
    before = set(threading.enumerate())
    server = LinkServer(**{"fingerprint": "v1", "timeout_s": PATIENCE_S} | options)
    try:
        yield server
    finally:
        server.close()
    assert set(threading.enumerate()) <= before


def honest_run(server, disturb=lambda: None, context=None):
    """A round with honest clients only, disturbed before each step; all must go as ever."""
    server.admit(BLOCKS, TOKENS, SHAPE)
    clients = [Client(server, Recorder(block), client_context=context) for block in BLOCKS]
    server.wait_connected(PATIENCE_S)
    heard = drive(_Disturbed(server, disturb), 3)
    assert [client.join() for client in clients] == [None, None]
    assert [array.tobytes() for array in heard] == UNDISTURBED


class _Disturbed:
    """A fleet to which something happens before each step."""

    def __init__(self, fleet, disturb):
        self._fleet, self._disturb = fleet, disturb

    def send_step(self, *arguments):
        self._disturb()
        self._fleet.send_step(*arguments)

    def __getattr__(self, name):
        return getattr(self._fleet, name)


class Peer:
    """A hostile connection that sends a piece of its script at a time, and then ends."""

    def __init__(self, server, script, context=None):
        self.sock = RawClient(server).sock
        if context is not None:
            self.sock = context.wrap_socket(self.sock)
        self._pieces = iter(script)

    def go_on(self):
        try:
            self.sock.sendall(next(self._pieces))
        except StopIteration:
            self.close()
        except OSError:
            pass  # we have been thrown out already

    def close(self):
        self.sock.close()


CERTIFICATE, KEY = run_certificate("127.0.0.1")


@pytest.mark.parametrize("where", ["without TLS", "where TLS is due", "inside TLS"])
@run_often
@given(st.lists(scripts, min_size=1, max_size=5))
def test_whatever_strangers_send_the_run_ends_in_the_same_bits(where, all_scripts):
    server_tls = client_tls = None
    if where != "without TLS":
        server_tls, client_tls = server_context(CERTIFICATE, KEY), client_context(CERTIFICATE)
    with link(server_context=server_tls) as server:
        server.admit(BLOCKS, TOKENS, SHAPE)
        strangers_tls = client_tls if where == "inside TLS" else None
        peers = [Peer(server, script, strangers_tls) for script in all_scripts]
        honest_run(server, lambda: [peer.go_on() for peer in peers], client_tls)
        honest_run(server, context=client_tls)
        for peer in peers:
            peer.close()


@run_often
@given(st.sampled_from(list(Expect)), scripts)
def test_whatever_an_admitted_robot_sends_it_is_named_and_the_next_round_is_sound(expect, script):
    with link() as server:
        server.admit(BLOCKS, TOKENS, SHAPE)
        bad = RawClient(server).hello((0,))
        honest = Client(server, Recorder((1, 2)))
        server.wait_connected(PATIENCE_S)
        for piece in script:
            bad.send(piece)
        bad.close()
        lost = None
        try:
            server.send_step(0, 1, expect, updates(3, 0))
            if expect is Expect.ACTIONS:
                assert server.actions(0).shape == (3,)
            elif expect is Expect.WEIGHTS:
                assert server.upload(1).shape == (3, *SHAPE)
        except (RobotLost, RobotFailed) as error:
            lost = error
        assert lost is None or (lost.robots == (0,) and str(lost).isprintable())
        honest_run(server)
        assert honest.join() is None or isinstance(honest.error, LinkError)


def test_frames_may_come_byte_by_byte(make_link):
    link = make_link()
    link.admit((0,))
    raw = link.raw()
    raw.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def drip(message):
        for byte in encode(message):
            raw.send(bytes([byte]))

    drip(Hello(VERSION, "v1", [0], [token(0)]))
    link.server.wait_connected(PATIENCE_S)
    assert decode(raw.receive()) == Welcome()
    link.server.send_step(0, 1, Expect.ACTIONS, updates(1, 0))
    dripping = threading.Thread(target=drip, args=(Actions(0, np.array([7], np.int32)),))
    dripping.start()
    assert link.server.actions(0).tolist() == [7]
    dripping.join(PATIENCE_S)


def test_who_drips_does_not_move_the_deadline(make_link):
    link = make_link(timeout_s=0.3)
    link.admit((0,))
    raw = link.raw().hello((0,))
    link.server.wait_connected(PATIENCE_S)
    link.server.send_step(0, 1, Expect.WEIGHTS, updates(1, 0))
    frame, ended = encode(Weights(1, np.zeros((1, *SHAPE), np.float32))), threading.Event()

    def drip():
        for byte in frame[:-1]:
            if ended.wait(0.05):
                return
            raw.send(bytes([byte]))

    dripping = threading.Thread(target=drip)
    dripping.start()
    with pytest.raises(LinkTimeout, match=r"robot 0 did not answer within 0\.3 s"):
        link.server.upload(1)
    assert dripping.is_alive()
    ended.set()
    dripping.join(PATIENCE_S)


FLOOD = 2 * MAX_PENDING
FLOODS = {
    "silence": b"",
    "garbage": b"x" * 200,
    "a frame without an end": b"RISF" * 30_000,
    "wrong token": Hello(VERSION, "v1", [0], ["wrong"]),
}


@pytest.fixture
def unlogged():
    """Each refusal is logged, and pytest would keep every line."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


def descriptors():
    return len(os.listdir("/proc/self/fd"))


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="counts descriptors in /proc")
@pytest.mark.parametrize("message", FLOODS.values(), ids=FLOODS)
@pytest.mark.usefixtures("unlogged")
def test_a_flood_of_connections_leaves_no_memory_and_no_descriptor_behind(message):
    with link(timeout_s=PATIENCE_S) as server:

        def flood():
            for _ in range(FLOOD):
                with contextlib.suppress(ConnectionError):
                    peer = RawClient(server)
                    peer.send(message)
                    peer.at_end() if message else peer.close()
                    peer.close()

        def held():
            """Bytes and descriptors after a flood."""
            flood()
            honest_run(server)
            gc.collect()
            return tracemalloc.get_traced_memory()[0], descriptors()

        tracemalloc.start()
        held()  # what is made once and kept, is kept from now on
        bytes_before, descriptors_before = held()
        bytes_after, descriptors_after = held()
        tracemalloc.stop()
    assert descriptors_after == descriptors_before
    assert bytes_after - bytes_before < 50 * FLOOD


def test_newcomers_who_say_nothing_are_never_more_than_the_door_holds(make_link):
    link = make_link(handshake_s=PATIENCE_S)
    link.admit(*BLOCKS)
    before = descriptors()
    crowd = [link.raw() for _ in range(FLOOD)]
    honest_run(link.server)
    assert descriptors() - before <= FLOOD + MAX_PENDING + len(BLOCKS)
    assert sum(peer.at_end() for peer in crowd[:MAX_PENDING]) == MAX_PENDING


def test_an_admitted_robot_that_floods_is_lost_and_its_flood_is_not_kept(make_link):
    link = make_link()
    link.admit((0,), (1,))
    bad, other = link.raw().hello((0,)), link.client((1,))
    link.server.wait_connected(PATIENCE_S)
    link.server.send_step(0, 1, Expect.ACTIONS, updates(2, 0))
    flood = encode(Actions(0, np.zeros(1, np.int32))) * 1000
    bad.sock.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        for _ in range(100_000):
            bad.sock.send(flood)
    tracemalloc.start()
    with pytest.raises(RobotLost, match=r"robot 0 lost .* out of turn"):
        link.server.actions(0)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2**17
    link.server.close()
    assert isinstance(other.join(), LinkError)


# --- The client -----------------------------------------------------------------------------------


class HostileServer:
    """Takes one client, says what it was told to say, and then ends or goes on and on."""

    def __init__(self, data, endless=b""):
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = self._listener.getsockname()
        self._data, self._endless = data, endless
        self._thread = threading.Thread(target=self._play)
        self._thread.start()

    def _play(self):
        with self._listener, self._listener.accept()[0] as sock:
            sock.settimeout(PATIENCE_S)
            with contextlib.suppress(OSError):
                sock.recv(65536)
                sock.sendall(self._data)
                while self._endless:
                    sock.sendall(self._endless)
                sock.shutdown(socket.SHUT_WR)
                while sock.recv(65536):
                    pass

    def meet(self, layout=PLAIN):
        """What a client of robot 0 makes of it: None, or an error of the link."""
        client = Client(self, Recorder((0,)), layout=layout)
        error = client.join()
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()
        assert error is None or isinstance(error, LinkError), repr(error)
        return error


@run_often
@given(st.integers(0, 5), scripts, st.sampled_from(LAYOUTS))
def test_whatever_a_server_says_the_client_ends_with_an_error_of_the_link(sound, script, layout):
    sound_frames = [encode(message) for message in [Welcome(), *good_conversation(layout)]]
    HostileServer(b"".join([*sound_frames[:sound], *script])).meet(layout)


@pytest.mark.parametrize(
    "endless",
    [encode(Welcome()), b"x" * 4096, encode(Weights(1, np.zeros((2, PARAMETERS), np.float32)))],
    ids=["welcomes", "garbage", "weights"],
)
@pytest.mark.usefixtures("in_a_hurry")
def test_a_client_leaves_a_server_that_talks_for_ever(endless):
    assert isinstance(HostileServer(encode(Welcome()), endless * 50).meet(), FrameError)


def test_a_client_takes_no_frame_longer_than_it_needs():
    over_long = HEADER.pack(b"RISF", VERSION, Kind.WEIGHTS, 0, 2**30)
    tracemalloc.start()
    error = HostileServer(encode(Welcome()) + over_long).meet()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert "of at most" in str(error)
    assert peak < 2**20


def test_a_download_of_another_shape_is_the_servers_fault():
    sound = good_conversation()[:2]
    wrong = Weights(1, np.zeros((2, PARAMETERS - 1), np.float32))
    error = HostileServer(b"".join(map(encode, [Welcome(), *sound, wrong]))).meet()
    assert isinstance(error, FrameError)
    assert "weights" in str(error)
