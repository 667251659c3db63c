"""Who gets in, who does not, and that nobody outside can disturb the run."""

import logging
import socket
import time

import numpy as np
import pytest
from link_helpers import PATIENCE_S, SHAPE, drive, token, updates

from lockstep.acceptor import MAX_PENDING
from lockstep.errors import LinkError, LinkTimeout, Refused, RobotFailed, RobotLost, ServerLost
from lockstep.frames import decode, encode
from lockstep.messages import VERSION, Actions, Expect, Failure, Hello, Welcome
from lockstep.messages import Rejection as RefusedMessage
from lockstep.server import LinkServer


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"tokens": ["secret-0", "wrong"]}, "token"),
        ({"tokens": ["secret-1", "secret-0"]}, "token"),
        ({"tokens": ["secret-0"]}, "no client is expected with robots 0, 1"),
        ({"robots": [0], "tokens": ["secret-0"]}, "no client is expected with robot 0"),
        ({"robots": [1, 0]}, "no client is expected with robots 1, 0"),
        ({"robots": [7], "tokens": ["secret-7"]}, "no client is expected with robot 7"),
        ({"version": 99}, f"version 99, the server {VERSION}"),
        ({"fingerprint": "v2"}, "runs 'v2', the server 'v1'"),
    ],
)
def test_a_wrong_hello_is_refused_with_a_reason_and_the_run_goes_on(link, caplog, change, reason):
    clients = link.connected((0, 1), (2,))
    link.server.send_step(0, 1, Expect.ACTIONS, updates(3, 0))
    raw = link.raw().hello((0, 1), **change)
    answer = decode(raw.receive())
    assert isinstance(answer, RefusedMessage)
    assert reason in answer.reason
    assert raw.at_end()
    link.server.actions(0)
    drive(link.server, 3)
    assert [client.join() for client in clients] == [None, None]
    assert reason in caplog.text
    assert "secret" not in caplog.text
    assert "secret" not in answer.reason


def test_the_client_raises_what_the_server_refuses(link):
    link.admit((0,))
    for changes, reason in (
        ({"fingerprint": "v2"}, "'v2', the server 'v1'"),
        ({"tokens": ["wrong"]}, "token"),
    ):
        error = link.client((0,), **changes).join()
        assert isinstance(error, Refused)
        assert reason in str(error)


def test_nobody_gets_in_while_no_round_is_open(link):
    raw = link.raw().hello((0,))
    assert decode(raw.receive()) == RefusedMessage("no round is open")
    for call in (
        lambda: link.server.wait_connected(1),
        lambda: link.server.send_step(0, 1, Expect.ACTIONS, updates(1, 0)),
    ):
        with pytest.raises(LinkError, match="no round is open"):
            call()


def test_tokens_of_the_round_before_are_worth_nothing(link):
    link.server.admit([(0,)], {0: "old"}, SHAPE)
    link.server.admit([(0,)], {0: "new"}, SHAPE)
    assert isinstance(link.client((0,), tokens=["old"]).join(), Refused)
    client = link.client((0,), tokens=["new"])
    link.server.wait_connected(PATIENCE_S)
    drive(link.server, 1)
    assert client.join() is None


def test_every_robot_needs_a_token(link):
    with pytest.raises(ValueError, match=r"no token for robots \[1\]"):
        link.server.admit([(0,), (1,)], {0: "a", 1: ""}, SHAPE)


def test_a_client_that_does_not_come_is_named_at_the_deadline(link):
    link.admit((0,), (1, 3), (2,))
    link.client((0,))
    with pytest.raises(LinkTimeout, match=r"robots 1, 2, 3 did not connect within 0.2 s"):
        link.server.wait_connected(0.2)


def test_the_caller_can_end_the_wait(link):
    link.admit((0,))
    calls = []

    def poll():
        calls.append(1)
        if len(calls) == 3:
            raise RuntimeError("Flower says: the client failed")

    with pytest.raises(RuntimeError, match="Flower says"):
        link.server.wait_connected(PATIENCE_S, poll)


def test_a_client_that_leaves_before_the_start_is_noticed(link):
    for last_words, error in ((None, RobotLost), (Failure("no disk"), RobotFailed)):
        link.admit((0,), (1,))
        raw = link.raw().hello((0,))
        raw.receive()
        if last_words:
            raw.send(last_words)
        raw.close()
        with pytest.raises(error, match=r"robot 0 .* before the first step"):
            link.server.wait_connected(PATIENCE_S)


GARBAGE = [
    b"GET / HTTP/1.1\r\nHost: x\r\n\r\n",
    b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(300),
    encode(Hello(1, "v1", [0], ["x"]))[:8] + b"\xff\xff\xff\xff",
    encode(Actions(0, np.zeros(1, np.int32))),
    encode(Hello(1, "v1", [0], [token(0)])) * 2,
    bytes(100_000),
    b"",
]


def test_garbage_and_slow_newcomers_disturb_nobody(make_link, caplog):
    link = make_link(handshake_s=0.25)
    link.admit((0,), (1, 2))
    slow = [link.raw().send(encode(Hello(1, "v1", [0], ["x"]))[:6]) for _ in range(3)]
    for data in GARBAGE:
        raw = link.raw()
        try:
            raw.send(data)
        except ConnectionError:
            continue
        if not data:
            raw.close()
    clients = [link.client((0,)), link.client((1, 2))]
    link.server.wait_connected(PATIENCE_S)
    drive(link.server, 3)
    assert [client.join() for client in clients] == [None, None]
    assert all(raw.at_end() for raw in slow)
    for reason in ("not a frame", "of at most", "must be a hello", "said no hello in time"):
        assert reason in caplog.text


def test_garbage_while_a_step_is_awaited_harms_nothing(link):
    clients = link.connected((0,), (1, 2))
    for tick in range(20):
        link.server.send_step(tick, 1, Expect.ACTIONS, updates(3, tick))
        link.raw().send(b"x" * 50)
        link.server.actions(tick)
    link.server.send_step(20, 1, Expect.END_ROUND, updates(3, 20))
    assert [client.join() for client in clients] == [None, None]


def test_a_crowd_at_the_door_does_not_keep_clients_out(link):
    crowd = [socket.create_connection(link.server.address) for _ in range(MAX_PENDING + 20)]
    (client,) = link.connected((0,))
    drive(link.server, 1)
    assert client.join() is None
    for sock in crowd:
        sock.close()


def test_a_valid_newcomer_replaces_the_old_connection_before_the_round_begins(link):
    link.admit((0,), (1,))
    old = link.raw().hello((0,))
    assert decode(old.receive()) == Welcome()
    new = link.raw().hello((0,))
    assert decode(new.receive()) == Welcome()
    other = link.client((1,))
    link.server.wait_connected(PATIENCE_S)
    assert old.at_end()
    link.server.send_step(0, 1, Expect.END_ROUND, updates(2, 0))
    assert decode(new.receive()).expect is Expect.END_ROUND
    assert other.join() is None


def test_a_client_that_comes_back_in_the_middle_has_lost_its_place(link, caplog):
    """It may have missed a step, or its answer may have been lost: it must be sent to a window."""
    caplog.set_level(logging.INFO)
    link.admit((0,), (1,))
    old, other = link.raw().hello((0,)), link.client((1,))
    link.server.wait_connected(PATIENCE_S)
    old.receive()
    link.server.send_step(0, 1, Expect.ACTIONS, updates(2, 0))
    old.receive()
    old.send(encode(Actions(0, np.zeros(1, np.int32)))[:-1])
    new = link.raw().hello((0,))
    assert decode(new.receive()) == Welcome()
    with pytest.raises(RobotLost, match=r"robot 0 lost at tick 0, .* it has come back"):
        link.server.actions(0)
    assert old.at_end()
    assert "a new connection of robot 0 replaces the old one" in caplog.text
    link.server.close()
    assert isinstance(other.join(), ServerLost)


def test_a_client_that_came_back_between_steps_has_lost_its_place(link):
    link.admit((0,))
    old = link.raw().hello((0,))
    link.server.wait_connected(PATIENCE_S)
    old.receive()
    link.server.send_step(0, 1, Expect.ACTIONS, updates(1, 0))
    old.receive()
    old.send(Actions(0, np.zeros(1, np.int32)))
    link.server.actions(0)
    new = link.raw().hello((0,))
    new.receive()
    deadline = time.monotonic() + PATIENCE_S
    while not link.server._acceptor.accepted and time.monotonic() < deadline:
        time.sleep(0.001)  # the welcome comes a moment before
    with pytest.raises(RobotLost, match="it has come back"):
        link.server.send_step(1, 1, Expect.ACTIONS, updates(1, 1))


def test_a_port_in_use_is_one_clear_sentence(link):
    host, port = link.server.address
    with pytest.raises(LinkError, match=f"cannot listen on {host}:{port}: .*in use"):
        LinkServer(host, port, fingerprint="v1", timeout_s=1)


def test_closing_twice_is_harmless(link):
    link.connected((0,))
    link.server.close()
    link.server.close()
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(link.server.address)
