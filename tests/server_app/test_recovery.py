"""Runs that lose robots, on a fake grid with the real ClientApp: the weights must not notice."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, cast

import pytest
from fake_grid import Client, FakeGrid
from flwr.app import Context, Message

from client_app.app import RoundConfig, train
from client_app.robots import RobotGroup
from conf import Config
from lockstep import LinkServer, LinkTimeout, RobotLost, ServerLost
from lockstep import client as link_client
from lockstep.errors import Disconnected
from server_app import recovery as lifeline_module
from server_app.clients import Clients
from server_app.nodes import RoundError, placed
from storage.checkpoint_files import checkpoints
from storage.checkpoint_layout import node_folder, robot_folder, server_folder

pytestmark = pytest.mark.usefixtures("hurried_flower")

Tiny = Callable[..., Config]
RUN = "0123456789abcdef"
PATIENCE_S = 60.0

KILLED = ServerLost("killed")  # the one kind of error of which the server is not told
CUT = Disconnected("the cable is cut")


class MovingGrid(FakeGrid):
    """A grid whose nodes may leave, and be back once the server has looked a few times."""

    looks_away = 0

    def leave_for_a_while(self, node: int) -> None:
        self.all_nodes, self.looks_away = list(self.nodes), 4
        self.nodes.remove(node)

    def get_node_ids(self) -> Iterable[int]:
        there = list(super().get_node_ids())
        if self.looks_away:
            self.looks_away -= 1
            if not self.looks_away:
                self.nodes[:] = self.all_nodes
        return there


def test_a_client_is_started_where_it_was_on_a_new_node_or_on_any_that_is_spare(
    deployed: Tiny,
) -> None:
    clients = Clients(deployed(), FakeGrid(4), cast(LinkServer, None), [100, 101, 102])
    clients._known, block = {100, 101, 102, 103}, (1,)
    assert clients._node_for(block, {100, 101, 102, 103}) == 101
    clients._pending = {block: "message"}  # of which nobody knows what became
    assert clients._node_for(block, {100, 101, 102, 103}) is None
    assert clients._node_for(block, {100, 101, 102, 103, 104}) == 104
    assert clients._node_for(block, {100, 102, 103}) == 103


# --- The same bits --------------------------------------------------------------------------------


@pytest.mark.parametrize("strategy", ["fedavg", "none"])
@pytest.mark.parametrize(
    ("tick", "back_to"), [(57, 4), (20, 0), pytest.param(7, 0, marks=pytest.mark.slow)]
)
def test_a_killed_client_is_started_anew_and_costs_no_bit(
    deployed: Tiny, run: Any, digests: Any, at_tick: Any, strategy: str, tick: int, back_to: int
) -> None:
    """At tick 20 the second window has just ended, and the first checkpoint is being written."""
    config = deployed({"strategy.name": strategy})
    expected = digests(config)
    at_tick(tick, 1, KILLED)
    summary = run(config, FakeGrid(3))
    assert summary["digest"] == expected
    (loss,) = summary["losses"]
    assert loss["loss"].startswith(f"robot 1 lost at tick {tick}")
    assert loss["back_to"] in {back_to, 2 if tick == 20 else back_to}


def test_a_client_whose_cable_was_cut_comes_back_by_itself(
    deployed: Tiny, run: Any, digests: Any, at_tick: Any
) -> None:
    config = deployed()
    expected = digests(config)
    at_tick(33, 2, CUT)
    grid = FakeGrid(3)
    assert run(config, grid)["digest"] == expected
    assert len(grid.sent) == 3  # no process had to be started


def test_a_client_that_comes_back_after_flower_gave_it_up_costs_no_bit(
    deployed: Tiny, run: Any, digests: Any, at_tick: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To Flower a node is offline after a minute's silence, and its client's reply is not taken."""
    config = deployed()
    expected = digests(config)
    grid = FakeGrid(3)
    connect, step = link_client._connected, RobotGroup.step

    def comes_back_late(*given: Any, if_refused: bool = True) -> Any:
        if not if_refused:
            grid.nodes = [100, 101]
            grid.give_up(2)
        return connect(*given, if_refused=if_refused)

    def is_online_later(self: RobotGroup, told: Any) -> Any:
        if told.tick == 60:
            grid.nodes = [100, 101, 102]
        return step(self, told)

    monkeypatch.setattr(link_client, "_connected", comes_back_late)
    monkeypatch.setattr(RobotGroup, "step", is_online_later)
    at_tick(33, 2, CUT)
    summary = run(config, grid)
    assert summary["digest"] == expected
    assert [loss["loss"].split(": ")[0] for loss in summary["losses"]] == [
        "robot 2 lost at tick 33, window 4",
        "robot 2 lost at the end of round 1",
    ]


def test_losses_one_after_the_other_cost_no_bit(
    deployed: Tiny, run: Any, digests: Any, at_tick: Any
) -> None:
    config = deployed()
    expected = digests(config)
    for tick, robot, error in ((15, 0, KILLED), (45, 1, CUT), (75, 2, KILLED), (90, 0, KILLED)):
        at_tick(tick, robot, error)
    summary = run(config, FakeGrid(3))
    assert summary["digest"] == expected
    assert [loss["back_to"] for loss in summary["losses"]] == [0, 4, 6, 8]


@pytest.mark.parametrize("per_round", [1, 3, pytest.param(5, marks=pytest.mark.slow)])
def test_a_client_that_dies_before_its_reply_costs_no_bit(
    deployed: Tiny, run: Any, digests: Any, per_round: int
) -> None:
    config = deployed({"federation.windows_per_round": per_round})
    expected = digests(config)
    served: list[int] = []

    def dies_once(message: Message, context: Context) -> Message:
        reply = train(message, context)
        served.append(1)
        if len(served) == 2:
            raise MemoryError("killed before its reply")
        return reply

    assert run(config, FakeGrid(3, {1: dies_once}))["digest"] == expected


def test_a_reply_that_comes_after_the_round_was_given_up_is_not_taken_for_the_next_ones(
    deployed: Tiny, run: Any, digests: Any
) -> None:
    config = deployed({"federation.windows_per_round": 3})
    expected = digests(config)
    grid = FakeGrid(3)

    def dies_once(message: Message, context: Context) -> Message:
        reply = train(message, context)
        if len(grid.sent) == 3:
            raise MemoryError("killed before its reply")
        return reply

    def late(message: Message, context: Context) -> Message:
        reply = train(message, context)
        end = time.monotonic() + PATIENCE_S
        while len(grid.sent) == 3 and time.monotonic() < end:  # until the next round has begun
            time.sleep(0.01)
        if message.metadata.group_id == "2":  # in which the others' replies come first
            time.sleep(0.5)
        return reply

    grid.clients = {1: dies_once, 2: late}
    assert run(config, grid)["digest"] == expected


def test_a_client_that_fails_before_it_has_joined_is_started_again(
    deployed: Tiny, run: Any, digests: Any
) -> None:
    config = deployed()
    expected = digests(config)
    tried: list[int] = []

    def late(message: Message, context: Context) -> Message:
        tried.append(1)
        if len(tried) < 3:
            raise OSError("not yet")
        return train(message, context)

    assert run(config, FakeGrid(3, {0: late}))["digest"] == expected


def test_a_node_that_has_gone_is_replaced_by_one_that_joins(
    deployed: Tiny, run: Any, digests: Any
) -> None:
    config = deployed()
    expected = digests(config)
    grid = FakeGrid(3)

    def vanishes(message: Message, context: Context) -> None:
        """The node's process dies with its client, so nobody ever replies; another one joins."""
        original = RobotGroup.step

        def step(self: RobotGroup, told: Any) -> Any:
            if told.tick == 52 and 1 in self.robots and 101 in grid.nodes:
                grid.nodes = [100, 102, 103]
                raise KILLED
            return original(self, told)

        RobotGroup.step = step
        try:
            train(message, context)
        except ServerLost:
            pass
        finally:
            RobotGroup.step = original

    grid.clients = {1: cast(Client, vanishes)}
    assert run(config, grid)["digest"] == expected
    assert [m.metadata.dst_node_id for m in grid.sent] == [100, 101, 102, 103]


def test_a_node_that_goes_between_rounds_is_waited_for(
    deployed: Tiny, run: Any, digests: Any
) -> None:
    """Its message is not taken until it is back."""
    config = deployed({"federation.windows_per_round": 3})
    expected = digests(config)
    grid = MovingGrid(3)

    def leaves_once(message: Message, context: Context) -> Message:
        reply = train(message, context)
        if len(grid.sent) == 3:
            grid.leave_for_a_while(101)
            raise OSError("stopped before its reply")
        return reply

    grid.clients = {1: leaves_once}
    assert run(config, grid)["digest"] == expected


def test_a_node_that_comes_back_under_its_number_is_asked_again(
    deployed: Tiny, run: Any, digests: Any, at_tick: Any
) -> None:
    """A SuperNode with a key is the same node when it is started again, and has forgotten all."""
    config = deployed()
    expected = digests(config)
    grid = MovingGrid(3)
    at_tick(52, 1, KILLED)

    def dies_with_its_node(message: Message, context: Context) -> Message | None:
        try:
            return train(message, context)
        except ServerLost:
            grid.leave_for_a_while(101)
            return None

    grid.clients = {1: dies_with_its_node}
    assert run(config, grid)["digest"] == expected
    assert [m.metadata.dst_node_id for m in grid.sent] == [100, 101, 102, 101]


def test_a_checkpoint_that_one_robot_lacks_is_not_gone_back_to(
    deployed: Tiny, run: Any, digests: Any, at_tick: Any
) -> None:
    config = deployed()
    expected = digests(config)
    folder = robot_folder(Path(str(config.run.dir)) / "state", 1)

    def tears(message: Message, context: Context) -> Message:
        for window in checkpoints(folder)[-1:]:
            path = folder / f"checkpoint-{window:012d}.safetensors"
            path.write_bytes(path.read_bytes()[:-7])
        return train(message, context)

    at_tick(68, 1, KILLED)
    summary = run(config, FakeGrid(3, {1: tears}))
    assert summary["digest"] == expected
    assert summary["losses"][0]["back_to"] == 4


# --- States on their nodes ------------------------------------------------------------------------


def test_each_node_keeps_its_robots_state_to_itself_and_is_found_again(
    deployed: Tiny, run: Any, digests: Any, tmp_path: Path
) -> None:
    """When the federation comes up again, its nodes have other numbers."""
    config = deployed({"runtime.connection": "mine"})
    expected = digests(config)

    def own(node: int) -> dict[str, str]:
        return {"state-dir": str(tmp_path / f"node-{node}")}

    short = deployed({"runtime.connection": "mine", "train.max_ticks": 70})
    run(short, FakeGrid(3, node_config=own))
    for robot in range(3):
        assert checkpoints(robot_folder(node_folder(tmp_path / f"node-{robot}", RUN), robot))
    assert not list((tmp_path / "run" / "state").glob("robot-*"))
    permuted = FakeGrid(3, node_config=lambda node: own((node + 1) % 3))
    assert run(config, permuted, resumes=True)["digest"] == expected


def test_a_node_without_a_robots_state_does_not_take_its_place(
    deployed: Tiny, run: Any, tmp_path: Path
) -> None:
    config = deployed({"runtime.connection": "mine", "train.max_ticks": 70})
    run(config, FakeGrid(3, node_config=lambda node: {"state-dir": str(tmp_path / f"{node}")}))
    fresh = FakeGrid(3, node_config=lambda node: {"state-dir": str(tmp_path / f"{2 * node}")})
    longer = deployed({"runtime.connection": "mine", "train.max_ticks": 120})
    with pytest.raises(RoundError, match=r"no node holds the checkpoints of robots 1"):
        run(longer, fresh, resumes=True)


def test_blocks_are_placed_by_augmenting_paths() -> None:
    held = {7: {0, 1}, 8: {0}, 9: {0, 1, 2}}
    assert placed([(0,), (1,), (2,)], held) == {(0,): 8, (1,): 7, (2,): 9}
    with pytest.raises(RoundError, match="of robots 2"):
        placed([(0,), (1,), (2,)], {7: {0, 1}, 8: {0}, 9: {0, 1}})


# --- The end of patience --------------------------------------------------------------------------


def test_without_waiting_a_loss_ends_the_run_by_name(
    deployed: Tiny, run: Any, at_tick: Any
) -> None:
    at_tick(33, 2, KILLED)
    with pytest.raises(RobotLost, match="robot 2 lost at tick 33, window 4"):
        run(deployed({"federation.on_loss": "abort"}), FakeGrid(3))


def test_a_robot_that_does_not_come_back_is_named_at_the_deadline(
    deployed: Tiny, run: Any, at_tick: Any
) -> None:
    config = deployed({"federation.loss_timeout_s": 0.3})
    at_tick(33, 2, KILLED)
    grid = FakeGrid(3)

    def once(message: Message, context: Context) -> Message | None:
        try:
            return train(message, context)
        except ServerLost:
            return None

    grid.clients = {2: once}
    with pytest.raises(LinkTimeout, match=r"robot 2 did not connect within"):
        run(config, grid)


def test_a_client_that_fails_again_and_again_ends_the_run_with_its_reason(
    deployed: Tiny, run: Any
) -> None:
    def broken(message: Message, context: Context) -> Message:
        raise ImportError("no module named torch")

    with pytest.raises(RoundError, match="robot 0 failed: ImportError: no module named torch"):
        run(deployed(), FakeGrid(3, {0: broken}))


def test_a_robots_own_failure_is_not_waited_out(deployed: Tiny, run: Any, at_tick: Any) -> None:
    at_tick(33, 2, OSError("no space left on device"))
    with pytest.raises(RuntimeError, match=r"robot 2 failed .* no space left on device"):
        run(deployed(), FakeGrid(3))


def test_a_run_that_never_gets_past_a_loss_is_given_up(
    deployed: Tiny, run: Any, at_tick: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lifeline_module, "MOST_IN_VAIN", 2)
    at_tick(33, 2, CUT, times=1000)
    with pytest.raises(RobotLost, match="robot 2 lost at tick 33"):
        run(deployed(), FakeGrid(3))


def test_states_that_have_gone_are_not_taken_for_a_beginning(
    deployed: Tiny, run: Any, at_tick: Any
) -> None:
    config = deployed()
    state = Path(str(config.run.dir)) / "state"

    def forgetful(message: Message, context: Context) -> Message:
        for path in robot_folder(state, 1).glob("checkpoint-*"):
            path.unlink()
        return train(message, context)

    at_tick(85, 1, KILLED)
    with pytest.raises(RoundError, match=r"no checkpoint in common with the server, .* 4, 6, 8"):
        run(config, FakeGrid(3, {1: forgetful}))
    assert checkpoints(server_folder(state))


def test_progress_says_who_is_waited_for(
    deployed: Tiny, run: Any, at_tick: Any, tmp_path: Path
) -> None:
    config = deployed()
    seen: list[dict[str, Any]] = []

    def looks(message: Message, context: Context) -> Message:
        path = tmp_path / "run" / "progress.json"
        if path.exists():
            seen.append(json.loads(path.read_text()))
        return train(message, context)

    at_tick(33, 2, KILLED)
    run(config, FakeGrid(3, {2: looks}))
    assert seen[-1]["state"] == "waiting"
    assert "robot 2 lost at tick 33" in seen[-1]["message"]
    end = json.loads((tmp_path / "run" / "progress.json").read_text())
    assert (end["state"], end["checkpoint"], end["round"]) == ("done", 12, 1)
    assert [client["robots"] for client in end["clients"]] == [[0], [1], [2]]


def test_an_order_names_the_round_and_the_certificate(deployed: Tiny, run: Any) -> None:
    grid = FakeGrid(3)
    run(deployed(), grid)
    order = RoundConfig.read(grid.orders(1)[0])
    assert (order.round, order.certificate, order.window) == (1, "", 0)
