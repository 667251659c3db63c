"""A building on a fake grid with the real ClientApp: the weights do not notice where rooms are."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from fake_grid import FakeGrid
from flwr.app import Array, Context, Error, Message
from flwr.serverapp import Grid

from client_app import app as client
from conf import Config
from server_app import buildings
from server_app.buildings import FlowerRooms, train_building
from server_app.nodes import MOST_FAILURES, RoundError
from storage.checkpoint_layout import node_folder, room_folder
from training.checkpoint import latest
from training.room_messages import ROOMS, read_asked
from training.rooms import RoomsLostError
from training.run_folder import RunFolder

pytestmark = pytest.mark.usefixtures("hurried_flower", "leaves_no_thread")

Building = Callable[..., Config]
RUN = "0123456789abcdef"


@pytest.fixture(autouse=True)
def _in_a_hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets the server look more often, and no process remember an earlier test's rooms."""
    monkeypatch.setattr(buildings, "POLL_S", 0.005)
    monkeypatch.setattr(buildings, "PAUSE_S", 0.01)
    monkeypatch.setattr(client, "_keepers", {})


@pytest.fixture
def deployed(tiny_building: Building, tmp_path: Path) -> Building:
    """The tiny building, deployed on nodes that other people have started."""

    def make(changes: dict[str, Any] | None = None) -> Config:
        standard = {
            "runtime.name": "deployment",
            "runtime.connection": "mine",
            "federation.clients": 2,
            "federation.loss_timeout_s": 60.0,
            "rooms.held_out": 0,
            "train.max_ticks": 30,
            "evaluation.every": 10**6,
            "evaluation.episodes": 1,
            "run.dir": str(tmp_path / "run"),
            "run.id": RUN,
        }
        return tiny_building({**standard, **(changes or {})})

    return make


@pytest.fixture
def grid(tmp_path: Path) -> Callable[..., FakeGrid]:
    """A grid whose nodes keep the states of their rooms by themselves."""

    def make(nodes: int, clients: dict[int, Any] | None = None) -> FakeGrid:
        return FakeGrid(nodes, clients, lambda node: {"state-dir": str(tmp_path / f"node-{node}")})

    return make


def run(config: Config, grid: FakeGrid, *, resumes: bool = False) -> dict[str, Any]:
    """Trains on a grid; returns the summary."""
    folder = RunFolder(Path(str(config.run.dir)))
    resumed = latest(folder.state, 0, config.run.id) if resumes else None
    train_building(cast(Grid, grid), config, folder, resumed)
    found: dict[str, Any] = json.loads(folder.summary_file.read_text())
    return found


def number_of(message: Message) -> int:
    """The round that a message asks for."""
    return int(cast(int, message.content.config_records[ROOMS]["number"]))


def rooms_of(message: Message) -> list[int]:
    """The rooms that a message asks for."""
    return [each.room.index for each in read_asked(message.content)[2].rooms]


def failing(rounds: dict[int, int], then: Any = None) -> Any:
    """A node whose client fails so often in rounds, before it plays or, with ``then``, after."""
    left = dict(rounds)

    def handler(message: Message, context: Context) -> Message | None:
        number = number_of(message)
        if left.get(number, 0):
            left[number] -= 1
            if then == "after":
                client.train(message, context)
            return Message(Error(1, "MemoryError: none is left"), reply_to=message)
        return client.train(message, context)

    return handler


# --- The same bits --------------------------------------------------------------------------------


@pytest.mark.parametrize("clients", [1, 2])
@pytest.mark.parametrize("access_points", ["own", "mean"])
def test_any_dealing_of_rooms_ends_in_the_bits_of_one_process(
    deployed: Building, grid: Any, digests: Any, clients: int, access_points: str
) -> None:
    config = deployed({"federation.clients": clients, "rooms.access_points": access_points})
    nodes = grid(clients)
    told = run(config, nodes)
    assert told["digest"] == digests(config)
    assert len(nodes.sent) == 3 * clients
    dealt = {1: [[0, 1, 2]], 2: [[0, 1], [2]]}[clients]
    assert [client["rooms"] for client in told["clients"]] == dealt
    assert all(client["flower_bytes"] > 0 for client in told["clients"])
    assert told["costs"]["flower_bytes"] == sum(each["flower_bytes"] for each in told["clients"])
    assert told["costs"]["client_cpu_s"] > 0


def test_clients_without_rooms_in_a_round_are_not_asked(
    deployed: Building, grid: Any, digests: Any
) -> None:
    config = deployed({"rooms.fraction": 0.34, "train.max_ticks": 60})
    nodes = grid(2)
    assert run(config, nodes)["digest"] == digests(config)
    assert len([m for m in nodes.sent if ROOMS in m.content.config_records]) == 6


@pytest.mark.parametrize("when", [None, "after"])
def test_a_client_that_fails_is_asked_again_and_costs_no_bit(
    deployed: Building, grid: Any, digests: Any, when: Any
) -> None:
    """Before it has played, or after, when its checkpoints are a round ahead."""
    config = deployed()
    nodes = grid(2, {1: failing({1: 1, 2: 2}, when)})
    assert run(config, nodes)["digest"] == digests(config)
    assert len(nodes.sent) == 3 * 2 + 3


def test_a_node_that_is_gone_is_waited_for(
    deployed: Building, grid: Any, digests: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = deployed()
    nodes = grid(2)
    looked: list[int] = []
    node_ids = nodes.get_node_ids

    def comes_back() -> Any:
        if any(number_of(m) == 2 for m in nodes.sent if ROOMS in m.content.config_records):
            looked.append(1)
            nodes.nodes = [100] if len(looked) < 30 else [100, 101]
        return node_ids()

    def silent_once(message: Message, context: Context) -> Message | None:
        if number_of(message) == 2 and len(looked) < 30:
            return None
        return client.train(message, context)

    nodes.clients[1] = silent_once
    monkeypatch.setattr(nodes, "get_node_ids", comes_back)
    assert run(config, nodes)["digest"] == digests(config)
    assert len(looked) >= 30


def test_a_node_under_another_name_is_found_by_the_rooms_that_it_holds(
    deployed: Building, grid: Any, digests: Any, tmp_path: Path
) -> None:
    """Two nodes come in its place; the one with the smaller name holds nothing."""
    config = deployed()
    nodes = grid(2)
    nodes.node_config = lambda node: {
        "state-dir": str(tmp_path / f"node-{1 if node == 7 else node}")
    }

    def leaves(message: Message, context: Context) -> Message | None:
        if number_of(message) == 2:
            nodes.nodes = [100, 105, 107]
            return Message(Error(1, "node unavailable"), reply_to=message)
        return client.train(message, context)

    nodes.clients[1] = leaves
    assert run(config, nodes)["digest"] == digests(config)
    asked = {m.metadata.dst_node_id for m in nodes.sent if ROOMS in m.content.config_records}
    assert asked == {100, 101, 107}
    held = room_folder(node_folder(tmp_path / "node-1", RUN), "0002")
    assert any(held.iterdir())


def test_a_run_goes_on_with_nodes_that_have_other_names(
    deployed: Building, grid: Any, digests: Any, tmp_path: Path
) -> None:
    config = deployed({"rooms.fraction": 0.67, "train.max_ticks": 40})
    expected = digests(config)
    stop = RunFolder(tmp_path / "run").stop_file

    def stops(message: Message, context: Context) -> Message | None:
        if number_of(message) == 2:
            stop.touch()
        return client.train(message, context)

    assert run(config, grid(2, {0: stops, 1: stops}))["stopped_early"]
    stop.unlink()
    swapped = grid(2)
    swapped.node_config = lambda node: {"state-dir": str(tmp_path / f"node-{1 - node}")}
    assert run(config, swapped, resumes=True)["digest"] == expected


# --- Rooms that miss a round ----------------------------------------------------------------------


def test_with_miss_the_rooms_of_a_client_that_fails_miss_the_round(
    deployed: Building, grid: Any, tmp_path: Path
) -> None:
    config = deployed({"federation.on_loss": "miss", "train.max_ticks": 40})
    nodes = grid(2, {1: failing({2: 9, 3: 1})})
    told = run(config, nodes)
    assert told["rooms"]["ticks"] == [40, 40, 20]
    assert len(nodes.sent) == 8  # nobody is asked twice


def test_with_miss_rooms_whose_reply_is_lost_play_on_from_where_the_server_knows_them(
    deployed: Building, grid: Any
) -> None:
    config = deployed({"federation.on_loss": "miss", "train.max_ticks": 70})
    lost = dict.fromkeys(range(2, 7), 1)
    told = run(config, grid(2, {1: failing(lost, "after")}))
    assert told["rooms"]["ticks"] == [70, 70, 20]


def test_a_round_that_all_rooms_miss_is_played_again(
    deployed: Building, grid: Any, digests: Any
) -> None:
    config = deployed({"federation.on_loss": "miss"})
    nodes = grid(2, {0: failing({2: 1}), 1: failing({2: 1})})
    told = run(config, nodes)
    assert told["rooms"]["ticks"] == [30] * 3
    assert told["digest"] == digests(deployed())


def test_with_miss_a_run_that_nobody_plays_ends(deployed: Building, grid: Any) -> None:
    config = deployed({"federation.on_loss": "miss", "federation.loss_timeout_s": 0.2})
    say = r"round 2: no room could be reached for 0.2 s \(MemoryError: none is left\)"
    with pytest.raises(RoomsLostError, match=say):
        run(config, grid(2, {0: failing({2: 10**6}), 1: failing({2: 10**6})}))


def test_a_round_is_missed_by_all_where_only_other_rooms_sites_are_there(
    deployed: Building, grid: Any
) -> None:
    """One room takes part in a round, and one site of two is there."""
    quick = {"federation.on_loss": "miss", "federation.loss_timeout_s": 0.2}
    config = deployed({**quick, "rooms.fraction": 0.34, "train.max_ticks": 60})
    told = run(config, grid(1))
    assert told["ticks"] == 60
    assert 0 < sum(told["rooms"]["ticks"]) < 60


def test_rooms_that_have_not_played_take_no_other_clients_node(
    deployed: Building, grid: Any
) -> None:
    config = deployed({"federation.on_loss": "miss"})
    failing_node = failing(dict.fromkeys(range(1, 9), 10**6))
    told = run(config, grid(2, {0: failing_node}))
    assert told["rooms"]["ticks"] == [0, 0, 30]
    host = FlowerRooms(config, cast(Grid, nodes := grid(2)))
    nodes.nodes = [101]
    assert host.node_for((0, 1), frozenset({2})) is None
    assert host.node_for((2,), frozenset({2})) == 101
    nodes.nodes = [100, 101]
    assert host.node_for((0, 1), frozenset({2})) == 100


# --- What ends a run ------------------------------------------------------------------------------


def test_with_abort_a_client_that_fails_ends_the_run(deployed: Building, grid: Any) -> None:
    config = deployed({"federation.on_loss": "abort"})
    with pytest.raises(RoundError, match="round 2: the Flower client of room 2 failed: MemoryE"):
        run(config, grid(2, {1: failing({2: 1})}))


def test_with_abort_a_node_that_is_gone_ends_the_run(deployed: Building, grid: Any) -> None:
    config = deployed({"federation.on_loss": "abort"})
    with pytest.raises(RoomsLostError, match="the Flower client of room 2: its Flower node has"):
        run(config, grid(1))


def test_a_node_is_not_waited_for_without_end(deployed: Building, grid: Any) -> None:
    config = deployed({"federation.loss_timeout_s": 0.1})
    with pytest.raises(RoomsLostError, match="round 1: the Flower client of room 2: its Flower"):
        run(config, grid(1))


def test_a_client_that_fails_again_and_again_ends_the_run(deployed: Building, grid: Any) -> None:
    nodes = grid(2, {0: failing({2: 99})})
    with pytest.raises(RoundError, match="round 2: the Flower client of rooms 0 to 1 failed: Mem"):
        run(deployed(), nodes)
    asked = [m for m in nodes.sent if number_of(m) == 2 and rooms_of(m) == [0, 1]]
    assert len(asked) == MOST_FAILURES + 1


def test_a_process_that_the_simulation_lost_ends_the_round(deployed: Building, grid: Any) -> None:
    def died(message: Message, context: Context) -> Message:
        return Message(Error(1, "ActorDiedError: it died"), reply_to=message)

    config = deployed({"runtime.name": "simulation", "runtime.connection": None})
    with pytest.raises(RoomsLostError, match="its process died without a word"):
        run(config, grid(2, {1: died}))


@pytest.mark.parametrize(
    ("name", "array", "message"),
    [
        ("model-2", None, "room 2 replied no float32 network"),
        ("model-2", np.nan, "room 2 replied absurd weights of its robots"),
        ("ap-2", np.nan, "room 2 replied absurd weights of its access point"),
        ("ap-2", None, "room 2 replied no float32 network"),
    ],
)
def test_a_reply_that_no_room_gives_ends_the_run(
    deployed: Building, grid: Any, name: str, array: float | None, message: str
) -> None:
    def hostile(message: Message, context: Context) -> Message:
        reply = client.train(message, context)
        record = reply.content.array_records["arrays"]
        if array is None:
            del record[name]
        else:
            record[name] = Array(record[name].numpy() + np.float32(array))
        return reply

    with pytest.raises(RoundError, match=f"round 1: {message}"):
        run(deployed(), grid(2, {1: hostile}))


def test_a_node_of_another_version_says_so(
    deployed: Building, grid: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, "fingerprint", lambda env: "another")
    with pytest.raises(RoundError, match="this node has another version of RISFleet"):
        run(deployed({"federation.on_loss": "abort"}), grid(2))
