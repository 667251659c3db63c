"""Whole conversations: in one process, over TCP, and where they break."""

import multiprocessing
import os
import signal
import socket
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from link_helpers import (
    PARAMETERS,
    PATIENCE_S,
    SHAPE,
    WIDE,
    Client,
    Recorder,
    ask,
    drive,
    token,
    updates,
)

from lockstep.client import serve
from lockstep.errors import (
    FrameError,
    LinkError,
    LinkTimeout,
    ProtocolError,
    RobotFailed,
    RobotLost,
    ServerLost,
)
from lockstep.frames import decode, encode
from lockstep.local import InProcessFleet
from lockstep.messages import (
    PLAIN,
    UPDATE,
    Actions,
    Expect,
    Failure,
    Layout,
    Step,
    Weights,
    Welcome,
)
from lockstep.server import LinkServer

BLOCKS = [(0,), (1, 2), (3,)]
SCATTERED = [(3, 1), (0,), (2,)]


def local(blocks, fail_at=None, layout=PLAIN):
    handlers = [Recorder(block, fail_at if block == blocks[0] else None) for block in blocks]
    return handlers, InProcessFleet([(handler.block, handler) for handler in handlers], layout)


@pytest.mark.parametrize("layout", [PLAIN, Layout(worlds=2), WIDE], ids=["plain", "worlds", "wide"])
@pytest.mark.parametrize("blocks", [BLOCKS, SCATTERED, [(0, 1, 2, 3)]])
def test_local_and_tcp_hold_the_same_conversation(make_link, blocks, layout):
    handlers, fleet = local(blocks, layout=layout)
    here = drive(fleet, 4, layout=layout)
    link = make_link(layout=layout)
    clients = link.connected(*blocks)
    there = drive(link.server, 4, layout=layout)
    assert [client.join() for client in clients] == [None] * len(blocks)
    assert len(here) == len(there) == 14
    for mine, other in zip(here, there, strict=True):
        assert mine.dtype == other.dtype
        np.testing.assert_array_equal(mine, other)
    for handler, client in zip(handlers, clients, strict=True):
        assert handler.calls == client.handler.calls


def test_each_robot_gets_its_own_record_and_its_answer_comes_back_in_robot_order(link):
    clients = link.connected(*SCATTERED)
    records = updates(4, 5)
    records["flags"] = 4
    link.server.send_step(5, 2, Expect.ACTIONS, records)
    assert link.server.actions(5).tolist() == (records["cell"] % 24).tolist()
    assert clients[0].handler.kept.tobytes() == records[[3, 1]].tobytes()


def test_each_robot_gets_its_records_of_all_worlds_and_answers_for_each(make_link):
    link = make_link(layout=WIDE)
    clients = link.connected(*SCATTERED)
    records = updates(4, 5, WIDE)
    link.server.send_step(5, 2, Expect.ACTIONS, records)
    driving = (records["flags"] & 4) != 0
    expected = np.where(driving, records["cell"] % 24, -1)
    np.testing.assert_array_equal(link.server.actions(5), expected)
    rows = [9, 10, 11, 3, 4, 5]
    assert clients[0].handler.kept.tobytes() == records[rows].tobytes()
    np.testing.assert_array_equal(clients[0].handler.kept["credit"], records["credit"][rows])


@pytest.mark.parametrize(
    "other",
    [
        Layout(worlds=2, broadcast=2, credit=True),
        Layout(worlds=3, broadcast=2),
        Layout(worlds=3, broadcast=1, credit=True),
        PLAIN,
    ],
)
def test_a_client_takes_no_step_of_another_layout(make_link, other):
    link = make_link(layout=WIDE)
    link.admit((0,), (1,))
    wrong, right = link.client((0,), layout=other), link.client((1,))
    link.server.wait_connected(PATIENCE_S)
    link.server.send_step(0, 1, Expect.ACTIONS, updates(2, 0, WIDE))
    with pytest.raises(RobotFailed, match=r"robot 0 failed .* FrameError: .* records"):
        link.server.actions(0)
    assert isinstance(wrong.join(), FrameError)
    link.server.close()
    assert isinstance(right.join(), ServerLost)


@pytest.mark.parametrize("where", ["local", "tcp"])
def test_what_a_handler_is_given_stays_as_it_was(link, where):
    if where == "local":
        (handler,), fleet = local([(0, 1)])
    else:
        (client,), fleet = link.connected((0, 1)), link.server
        handler = client.handler
    first = updates(2, 0)
    expected = first.tobytes()
    fleet.send_step(0, 1, Expect.WEIGHTS, first)
    model = fleet.upload(1).mean(axis=0)
    fleet.download(1, model)
    kept, expected_model = handler.kept, model.copy()
    model += 1
    first["cell"] += 1
    fleet.send_step(1, 2, Expect.ACTIONS, updates(2, 1))
    fleet.actions(1)
    fleet.send_step(2, 2, Expect.ACTIONS, updates(2, 2))
    fleet.actions(2)
    assert kept.tobytes() == expected
    np.testing.assert_array_equal(handler.model, expected_model)


def test_one_server_holds_round_after_round(link):
    for _ in range(3):
        clients = link.connected((0, 1), (2,))
        drive(link.server, 3)
        assert [client.join() for client in clients] == [None, None]
    stats = link.server.stats()
    assert set(stats) == {(0, 1), (2,)}
    sent = stats[0, 1]
    assert sent.frames_sent == 3 * (13 + 2 + 1)
    assert sent.frames_received == 3 * (12 + 2)
    assert sent.bytes_sent > stats[2,].bytes_sent > 0
    assert sent.bytes_received > stats[2,].bytes_received > 0
    assert sent.waited_s > 0


def test_a_client_is_ahead_while_others_have_not_answered_and_never_when_alone(make_link):
    stats = []
    for blocks in [[(0, 1)], [(0,), (1,)]]:
        link = make_link()
        clients = link.connected(*blocks)
        drive(link.server, 2)
        assert [client.join() for client in clients] == [None, None][: len(clients)]
        stats.append(link.server.stats())
    assert stats[0][0, 1].ahead_s == 0
    first, second = stats[1][0,], stats[1][1,]
    assert first.gathered_s == second.gathered_s
    assert min(first.ahead_s, second.ahead_s) >= 0
    assert first.ahead_s + second.ahead_s > 0


def test_large_weights_travel_whole(make_link):
    link = make_link()
    shape = (2, 1_000_000)
    link.server.admit([(0, 1)], {0: "a", 1: "b"}, shape)

    class Heavy(Recorder):
        def upload(self):
            return np.arange(2 * 2 * shape[1], dtype=np.float32).reshape(2, *shape)

    client = Client(link.server, Heavy((0, 1)), tokens=["a", "b"], n_parameters=shape[1])
    link.server.wait_connected(PATIENCE_S)
    link.server.send_step(0, 1, Expect.WEIGHTS, updates(2, 0))
    uploaded = link.server.upload(1)
    np.testing.assert_array_equal(uploaded, client.handler.upload())
    link.server.download(1, uploaded[1])
    link.server.send_step(1, 1, Expect.END_ROUND, updates(2, 1))
    assert client.join() is None
    np.testing.assert_array_equal(client.handler.model, uploaded[1])


@pytest.mark.parametrize("where", ["local", "tcp"])
def test_a_handlers_exception_comes_out_with_its_reason(link, where):
    if where == "local":
        _, fleet = local([(0, 1), (2,)], fail_at=2)
    else:
        failing, other = link.connected((0, 1), (2,), fail_at=2)
        fleet = link.server
    with pytest.raises(RobotFailed, match="ValueError: the replay is full") as caught:
        drive(fleet, 3)
    assert caught.value.robots == (0, 1)
    assert "robots 0, 1 failed at tick 2, window 1" in str(caught.value)
    if where == "tcp":
        assert isinstance(failing.join(), ValueError)
        link.server.close("robot 0 failed")
        assert "robot 0 failed" in str(other.join())


def test_a_failure_that_came_before_the_next_step_is_still_told(link):
    link.admit((0,))
    raw = link.raw().hello((0,))
    link.server.wait_connected(PATIENCE_S)
    raw.send(Failure("disk full")).close()
    time.sleep(0.1)
    with pytest.raises(RobotFailed, match="disk full"):
        ask(link.server, 1, 0)


@pytest.mark.parametrize("where", ["local", "tcp"])
@pytest.mark.parametrize("answer", [None, np.zeros(3, np.int32), np.zeros(2), [0, 0]])
def test_an_unfit_answer_of_a_handler_is_its_own_failure(link, where, answer):
    class Unfit(Recorder):
        def step(self, step):
            return answer

    if where == "local":
        fleet = InProcessFleet([((0, 1), Unfit((0, 1)))])
    else:
        fleet = link.admit((0, 1))
        client = Client(fleet, Unfit((0, 1)))
        fleet.wait_connected(PATIENCE_S)
    with pytest.raises(RobotFailed, match="int32"):
        drive(fleet, 2)
    if where == "tcp":
        assert isinstance(client.join(), TypeError | ValueError)


def serve_here(address, timeout_s, handler=None):
    """Serves robot 0, or a handler's, in this thread."""
    handler = handler or Recorder((0,))
    tokens = [token(robot) for robot in handler.block]
    options = {"fingerprint": "v1", "timeout_s": timeout_s, "n_parameters": PARAMETERS}
    serve(address, handler.block, tokens, handler, **options)


def _serve_slowly(address):
    class Slow(Recorder):
        def step(self, step):
            time.sleep(60)

    serve_here(address, 60.0, Slow((1,)))


def test_a_killed_client_is_noticed_while_another_is_awaited_and_named(link):
    link.admit((0,), (1,))
    silent = link.raw().hello((0,))
    process = multiprocessing.get_context("spawn").Process(
        target=_serve_slowly, args=(link.server.address,), daemon=True
    )
    process.start()
    try:
        link.server.wait_connected(60)
        link.server.send_step(41, 3, Expect.ACTIONS, updates(2, 41))
        os.kill(process.pid, signal.SIGKILL)
        with pytest.raises(RobotLost, match="robot 1 lost at tick 41, window 3") as caught:
            link.server.actions(41)
        assert caught.value.robots == (1,)
    finally:
        process.kill()
        process.join(PATIENCE_S)
    silent.close()


def test_half_an_answer_and_then_the_end_is_a_lost_robot(link):
    link.admit((0,))
    raw = link.raw().hello((0,))
    link.server.wait_connected(PATIENCE_S)
    link.server.send_step(1, 1, Expect.ACTIONS, updates(1, 1))
    raw.send(encode(Actions(1, np.zeros(1, np.int32)))[:-2])
    raw.sock.shutdown(socket.SHUT_WR)
    with pytest.raises(RobotLost, match="closed by the other side"):
        link.server.actions(1)


ONE = np.zeros(1, np.int32)


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", "not a frame"),
        (encode(Actions(1, ONE))[:8] + b"\xff\xff\xff\x7f", "of at most"),
        (Actions(2, ONE), "of tick 1"),
        (Actions(1, np.zeros(2, np.int32)), "2 actions where 1 are due"),
        (encode(Actions(1, ONE)) * 2, "out of turn"),
        (Weights(1, np.zeros((1, *SHAPE), np.float32)), "Weights where actions"),
        (Welcome(), "Welcome where actions"),
        (Step(1, 1, Expect.ACTIONS, np.zeros(1, UPDATE)), "Step where actions"),
    ],
)
def test_a_bad_answer_closes_its_connection_and_names_the_reason(link, caplog, answer, reason):
    link.admit((0,), (1,))
    raw, other = link.raw().hello((0,)), link.client((1,))
    link.server.wait_connected(PATIENCE_S)
    raw.receive()
    link.server.send_step(1, 1, Expect.ACTIONS, updates(2, 1))
    raw.receive()
    raw.send(answer)
    with pytest.raises(RobotLost, match=reason) as caught:
        link.server.actions(1)
    assert caught.value.robots == (0,)
    assert reason in caplog.text
    assert raw.at_end()
    link.server.close()
    assert isinstance(other.join(), ServerLost)


@pytest.mark.parametrize(
    ("weights", "reason"),
    [
        (Weights(2, np.zeros((1, *SHAPE), np.float32)), "window 1"),
        (Weights(1, np.zeros(SHAPE, np.float32)), "shape"),
        (Weights(1, np.zeros((2, *SHAPE), np.float32)[:, :, :-1]), "shape"),
        (Weights(1, np.zeros((9, 2, 1000), np.float32)), "of at most"),
        (Actions(0, ONE), "Actions where weights"),
    ],
)
def test_a_bad_upload_closes_its_connection_and_names_the_reason(link, weights, reason):
    link.admit((0,))
    raw = link.raw().hello((0,))
    link.server.wait_connected(PATIENCE_S)
    link.server.send_step(0, 1, Expect.WEIGHTS, updates(1, 0))
    raw.send(weights)
    with pytest.raises(RobotLost, match=reason):
        link.server.upload(1)


def test_a_frame_that_nobody_asked_for_loses_the_robot(link):
    link.admit((0,), (1,))
    raw, _ = link.raw().hello((0,)), link.client((1,))
    link.server.wait_connected(PATIENCE_S)
    link.server.send_step(0, 1, Expect.ACTIONS, updates(2, 0))
    raw.send(Actions(0, ONE))
    link.server.actions(0)
    raw.send(Actions(1, ONE))
    time.sleep(0.1)
    link.server.send_step(1, 1, Expect.ACTIONS, updates(2, 1))
    raw.send(Actions(1, ONE))
    with pytest.raises(RobotLost, match="out of turn"):
        link.server.actions(1)


def test_a_silent_robot_is_named_at_the_deadline(make_link):
    link = make_link(timeout_s=0.2)
    link.admit((0, 2), (1,))
    silent, other = link.raw().hello((0, 2)), link.client((1,))
    link.server.wait_connected(PATIENCE_S)
    link.server.send_step(6, 2, Expect.ACTIONS, updates(3, 6))
    with pytest.raises(LinkTimeout, match=r"robots 0, 2 did not answer .* at tick 6, window 2"):
        link.server.actions(6)
    link.server.close()
    assert isinstance(other.join(), ServerLost)
    silent.close()


def test_a_robot_that_is_lost_stays_lost_until_the_next_round(link):
    link.admit((0,))
    raw = link.raw().hello((0,))
    link.server.wait_connected(PATIENCE_S)
    raw.receive()
    raw.close()
    for tick in range(2):
        with pytest.raises(RobotLost):
            ask(link.server, 1, tick)
    clients = link.connected((0,))
    drive(link.server, 1)
    assert clients[0].join() is None


def test_the_client_says_when_the_server_goes(link):
    (client,) = link.connected((0,))
    link.server.send_step(0, 1, Expect.ACTIONS, updates(1, 0))
    link.server.actions(0)
    link.server.close("out of power")
    error = client.join()
    assert isinstance(error, ServerLost)
    assert "out of power" in str(error)


@pytest.mark.parametrize(
    ("frames", "error"),
    [
        ([], ServerLost),
        ([Failure("x")], FrameError),
        ([Welcome()], ServerLost),
        ([Welcome(), Step(0, 1, Expect.ACTIONS, np.zeros(2, UPDATE))], FrameError),
        ([Welcome(), Weights(1, np.zeros(SHAPE, np.float32))], FrameError),
        ([Welcome(), Welcome()], FrameError),
    ],
)
def test_the_client_takes_nothing_out_of_turn_from_the_server(frames, error):
    listener = socket.create_server(("127.0.0.1", 0))

    def play():
        with listener, listener.accept()[0] as sock:
            sock.recv(65536)
            sock.sendall(b"".join(map(encode, frames)))
            sock.shutdown(socket.SHUT_WR)
            sock.settimeout(PATIENCE_S)
            while sock.recv(65536):
                pass

    thread = threading.Thread(target=play)
    thread.start()
    with pytest.raises(error):
        serve_here(listener.getsockname(), PATIENCE_S)
    thread.join(PATIENCE_S)
    assert not thread.is_alive()


@pytest.mark.parametrize("silent", ["before", "after"])
@pytest.mark.usefixtures("in_a_hurry")
def test_the_client_does_not_wait_for_ever(link, silent):
    link.admit((0,))
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = listener.getsockname() if silent == "before" else link.server.address
        with pytest.raises(LinkTimeout, match=r"no word from the server for 0\.2 s"):
            serve_here(address, timeout_s=0.2)


def test_the_client_waits_for_a_server_that_is_late():
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = free.getsockname()

    client = Client(SimpleNamespace(address=address), Recorder((0,)), fingerprint="v1")
    time.sleep(0.1)
    server = LinkServer(*address, fingerprint="v1", timeout_s=PATIENCE_S)
    server.admit([(0,)], {0: token(0)}, SHAPE)
    server.wait_connected(PATIENCE_S)
    drive(server, 1)
    assert client.join() is None
    server.close()


def test_without_a_server_the_client_gives_up():
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = free.getsockname()
    with pytest.raises(ServerLost, match=r"no connection to 127.0.0.1"):
        serve_here(address, timeout_s=0.1)


@pytest.mark.parametrize("where", ["local", "tcp"])
def test_the_order_of_the_conversation_is_held(link, where):
    if where == "local":
        _, fleet = local([(0,)])
    else:
        link.connected((0,))
        fleet = link.server
    records = updates(1, 0)
    model = np.zeros(SHAPE, np.float32)
    with pytest.raises(ProtocolError, match="before the first step"):
        fleet.actions(0)
    fleet.send_step(3, 1, Expect.ACTIONS, records)
    for wrong in (
        lambda: fleet.send_step(4, 1, Expect.ACTIONS, records),
        lambda: fleet.actions(4),
        lambda: fleet.upload(1),
    ):
        with pytest.raises(ProtocolError, match="at tick 3, window 1"):
            wrong()
    fleet.actions(3)
    fleet.send_step(4, 1, Expect.WEIGHTS, records)
    for wrong in (lambda: fleet.actions(4), lambda: fleet.upload(2)):
        with pytest.raises(ProtocolError):
            wrong()
    fleet.upload(1)
    with pytest.raises(ProtocolError):
        fleet.download(2, model)
    fleet.download(1, model)
    with pytest.raises(ProtocolError):
        fleet.download(1, model)
    fleet.send_step(5, 2, Expect.END_ROUND, records)
    with pytest.raises(ProtocolError, match="a new round is due"):
        fleet.send_step(6, 2, Expect.ACTIONS, records)


@pytest.mark.parametrize("where", ["local", "tcp"])
def test_wrong_arrays_are_refused_before_anything_is_sent(link, where):
    if where == "local":
        _, fleet = local([(0, 1)])
    else:
        link.connected((0, 1))
        fleet = link.server
    for wrong in (np.zeros(3, UPDATE), np.zeros(2), np.zeros((2, 1), UPDATE)):
        with pytest.raises(ValueError, match="UPDATE"):
            fleet.send_step(0, 1, Expect.ACTIONS, wrong)
    fleet.send_step(0, 1, Expect.WEIGHTS, updates(2, 0))
    fleet.upload(1)
    for wrong in (np.zeros(SHAPE), np.zeros((2, 3), np.float32)):
        with pytest.raises(ValueError, match="float32"):
            fleet.download(1, wrong)
    fleet.download(1, np.zeros(SHAPE, np.float32))


@pytest.mark.parametrize("blocks", [[], [(0,), ()], [(0,), (0,)], [(1,)], [(0,), (2,)], [(-1, 0)]])
def test_blocks_must_deal_every_robot_once(link, blocks):
    with pytest.raises(ValueError, match="each robot from 0 to K-1 once"):
        InProcessFleet([(block, Recorder(block)) for block in blocks])
    with pytest.raises(ValueError, match="each robot from 0 to K-1 once"):
        link.admit(*blocks)


def test_a_closed_local_fleet_takes_no_more():
    _, fleet = local([(0,)])
    fleet.close()
    with pytest.raises(LinkError, match="closed"):
        fleet.send_step(0, 1, Expect.ACTIONS, updates(1, 0))


def test_a_lost_farewell_is_no_frame_for_the_next_round(link):
    link.connected((0,))
    drive(link.server, 1)
    raw = link.raw()
    link.admit((0,))
    raw.hello((0,))
    assert decode(raw.receive()) == Welcome()
