"""Robots that are lost and come back: all are sent to one window, and nothing older counts."""

import socket
import threading

import numpy as np
import pytest
from link_helpers import PATIENCE_S, SHAPE, ask, drive, token, updates

from lockstep.errors import Disconnected, LinkTimeout, Refused, RobotFailed, RobotLost, ServerLost
from lockstep.frames import decode, encode
from lockstep.messages import Abort, Ack, Actions, Expect, Restore, Weights, Welcome

MODEL = np.arange(22, dtype=np.float32).reshape(SHAPE)


def ask_for_ever(fleet, robots):
    for tick in range(1, 100):
        ask(fleet, robots, tick)


def begun(handler):
    return [call for call in handler.calls if call[0] == "begin"]


@pytest.mark.parametrize("model", [MODEL, None], ids=["model", "none"])
def test_all_are_sent_to_a_window_and_go_on_from_there(link, model):
    clients = link.connected((0, 2), (1,))
    ask(link.server, 3, 0)
    link.server.begin(7, model)
    sent = None if model is None else model.tobytes()
    for client in clients:
        assert begun(client.handler) == [("begin", 7, sent)]
    drive(link.server, 3)
    assert [client.join() for client in clients] == [None, None]


def test_it_is_the_same_in_one_process(link):
    from link_helpers import Recorder

    from lockstep.local import InProcessFleet

    handlers = [Recorder((0,)), Recorder((1,))]
    fleet = InProcessFleet([((0,), handlers[0]), ((1,), handlers[1])])
    fleet.begin(4, MODEL)
    assert [begun(handler) for handler in handlers] == [[("begin", 4, MODEL.tobytes())]] * 2
    assert drive(fleet, 2)


def test_a_robot_that_cannot_go_there_says_why(link):
    (client,) = link.connected((0,))

    def begin(window, model):
        raise OSError("the checkpoint is damaged")

    client.handler.begin = begin
    with pytest.raises(RobotFailed, match="the checkpoint is damaged"):
        link.server.begin(7, None)
    assert isinstance(client.join(), OSError)


@pytest.mark.parametrize("stop", [SystemExit, KeyboardInterrupt])
def test_a_client_that_is_told_to_stop_is_lost_and_has_not_failed(link, stop):
    """As Flower stops a client whose SuperNode has died."""
    (client,) = link.connected((0,))

    def step(told):
        raise stop

    client.handler.step = step
    with pytest.raises(RobotLost, match="robot 0 lost at tick 0"):
        ask(link.server, 1, 0)
    assert isinstance(client.join(), stop)


def test_answers_from_before_are_dropped_and_never_taken_for_new_ones(link):
    """A survivor's answer is under way while another robot is lost."""
    link.admit((0,), (1,))
    survivor, lost = link.raw().hello((0,)), link.raw().hello((1,))
    link.server.wait_connected(PATIENCE_S)
    assert [decode(raw.receive()) for raw in (survivor, lost)] == [Welcome()] * 2
    link.server.send_step(5, 1, Expect.ACTIONS, updates(2, 5))
    survivor.receive()
    lost.close()
    with pytest.raises(RobotLost, match="robot 1 lost at tick 5"):
        link.server.actions(5)
    survivor.send(Actions(5, np.array([3], np.int32)))
    assert link.server.free() == [(1,)]
    back = link.raw().hello((1,))
    link.server.wait_connected(PATIENCE_S)
    back.receive()
    beginning = threading.Thread(target=link.server.begin, args=(20, MODEL))
    beginning.start()
    for raw in (survivor, back):
        begin = decode(raw.receive())
        assert isinstance(begin, Restore)
        assert (begin.window, begin.model.tobytes()) == (20, MODEL.tobytes())
        raw.send(Weights(1, np.zeros((1, *SHAPE), np.float32)) if raw is survivor else b"")
        raw.send(Ack(begin.number))
    beginning.join(PATIENCE_S)
    link.server.send_step(5, 1, Expect.ACTIONS, updates(2, 5))
    for raw, action in ((survivor, 8), (back, 9)):
        raw.receive()
        raw.send(Actions(5, np.array([action], np.int32)))
    np.testing.assert_array_equal(link.server.actions(5), [8, 9])


def test_the_ready_of_an_earlier_beginning_does_not_count(make_link):
    link = make_link(timeout_s=0.2)
    link.admit((0,))
    raw = link.raw().hello((0,))
    link.server.wait_connected(PATIENCE_S)
    raw.receive()
    raw.send(Ack(0))
    with pytest.raises(LinkTimeout, match="robot 0 did not answer"):
        link.server.begin(3, None)


def test_the_server_knows_the_windows_that_all_have_now(link):
    clients = link.connected((0,), (1,))
    ask(link.server, 2, 0)
    clients[0].handler.kept_windows = [20, 40, 60]
    clients[1].handler.kept_windows = [40, 60, 80]
    assert link.server.halt() == [40, 60]
    link.server.begin(60, MODEL)
    drive(link.server, 2)
    assert [client.join() for client in clients] == [None, None]


def test_a_client_comes_back_by_itself_when_its_connection_breaks(link):
    link.admit((0,), (1,))
    cut, other = link.client((0,), reconnect_timeout_s=PATIENCE_S), link.client((1,))
    link.server.wait_connected(PATIENCE_S)
    ask(link.server, 2, 0)
    slot = link.server._open.slots[(0,)]
    slot.stream._sock.shutdown(socket.SHUT_RDWR)
    with pytest.raises(RobotLost, match="robot 0 lost"):
        ask_for_ever(link.server, 2)
    link.server.wait_connected(PATIENCE_S)
    link.server.begin(4, MODEL)
    drive(link.server, 2)
    assert (cut.join(), other.join()) == (None, None)
    assert begun(cut.handler) == [("begin", 4, MODEL.tobytes())]


def test_a_server_that_has_died_is_not_waited_for(link):
    link.admit((0,))
    client = link.client((0,), reconnect_timeout_s=600.0)
    link.server.wait_connected(PATIENCE_S)
    ask(link.server, 1, 0)
    link.server._acceptor.shut()
    link.server._open.slots[(0,)].stream.close()  # as when its process is killed: without a word
    error = client.join()
    assert isinstance(error, ServerLost)
    assert "Connection refused" in str(error)


def test_without_a_time_to_return_a_broken_connection_is_the_end(link):
    (client,) = link.connected((0,))
    link.server._open.slots[(0,)].stream._sock.shutdown(socket.SHUT_RDWR)
    assert isinstance(client.join(), Disconnected)


def test_a_successors_tokens_shut_the_one_before_out(link):
    link.admit((0,), (1,))
    before, other = link.client((0,), reconnect_timeout_s=PATIENCE_S), link.client((1,))
    link.server.wait_connected(PATIENCE_S)
    link.server.renew((0,), {0: "fresh"})
    error = before.join()
    assert isinstance(error, Refused)
    assert "is not valid in this round" in str(error)
    successor = link.client((0,), tokens=["fresh"])
    link.server.wait_connected(PATIENCE_S)
    link.server.begin(0, None)
    drive(link.server, 2)
    assert (successor.join(), other.join()) == (None, None)


def test_whoever_did_not_answer_in_time_is_out_and_may_come_back(make_link):
    link = make_link(timeout_s=0.2)
    link.admit((0,))
    silent = link.raw().hello((0,))
    link.server.wait_connected(PATIENCE_S)
    silent.receive()
    with pytest.raises(LinkTimeout):
        ask(link.server, 1, 0)
    assert silent.at_end() is not None
    assert link.server.free() == [(0,)]
    back = link.client((0,), tokens=[token(0)])
    link.server.wait_connected(PATIENCE_S)
    link.server.begin(0, None)
    drive(link.server, 1)
    assert back.join() is None


def test_frames_of_a_beginning_hold_what_they_were_made_of():
    for model in (None, MODEL):
        begin = decode(encode(Restore(3, 40, model)))
        assert (begin.number, begin.window) == (3, 40)
        assert (begin.model is None) if model is None else (begin.model == model).all()
    assert decode(encode(Ack(9))) == Ack(9)
    assert decode(encode(Ack(9, (20, 40)))) == Ack(9, (20, 40))
    assert decode(encode(Abort(7))) == Abort(7)
