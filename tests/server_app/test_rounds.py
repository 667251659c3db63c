"""Rounds on Flower: a fake grid runs the real ClientApp on threads; the weights must not notice."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from fake_grid import FakeGrid
from flwr.app import Array, ArrayRecord, Context, Message, MetricRecord, RecordDict
from flwr.serverapp import Grid

from client_app.app import RoundConfig, train
from client_app.robots import RobotGroup
from client_app.state import CheckpointedRobots
from conf import Config, fingerprint, from_yaml, robot_network, to_yaml
from env.seeding import Stream, stream
from lockstep import LinkError, LinkServer, RobotLost, serve
from server_app.clients import Clients
from server_app.nodes import RoundError, wait_for_nodes
from server_app.rounds import FlowerFleet
from storage.checkpoint_layout import robot_windows, round_folder
from training.partition import partition_robots

pytestmark = pytest.mark.usefixtures("hurried_flower")

Tiny = Callable[..., Config]
Play = Callable[..., Any]
PATIENCE_S = 120.0
RATES = {
    "fedprox": {"strategy.proximal_mu": 0.5},
    "fedavgm": {"strategy.server_rate": 0.5, "strategy.momentum": 0.5},
    "fedadam": {"strategy.server_rate": 0.01, "strategy.beta_1": 0.9, "strategy.tau": 0.001},
}


@pytest.fixture
def open_link(leaves_no_thread: None) -> Iterator[Callable[[], LinkServer]]:
    opened: list[LinkServer] = []

    def make() -> LinkServer:
        opened.append(LinkServer(fingerprint=fingerprint(), timeout_s=20.0))
        return opened[-1]

    yield make
    for link in opened:
        link.close()


@pytest.fixture
def make_fleet(
    open_link: Callable[[], LinkServer],
) -> Callable[..., FlowerFleet]:
    def make(config: Config, grid: FakeGrid) -> FlowerFleet:
        initial = robot_network(config).initial_pair(stream(config.seed, Stream.WEIGHTS))
        nodes = wait_for_nodes(cast(Grid, grid), len(grid.nodes), 1.0)
        from_yaml(to_yaml(config))  # all clients read it, and find it read
        link = open_link()
        fleet = FlowerFleet(config, link, Clients(config, cast(Grid, grid), link, nodes))
        fleet.begin(0, initial)
        return fleet

    return make


@pytest.fixture
def on_flower(tiny: Tiny, tmp_path: Path) -> Tiny:
    """The tiny task as it would be on Flower: with an absolute folder and a short patience."""

    def make(changes: dict[str, Any] | None = None) -> Config:
        standard = {
            "runtime.name": "simulation",
            "runtime.start_timeout_s": PATIENCE_S,
            "federation.link.timeout_s": 3.0,
            "run.dir": str(tmp_path / "run"),
        }
        return tiny({**standard, **(changes or {})})

    return make


# --- Dealing and waiting --------------------------------------------------------------------------


@pytest.mark.parametrize("robots", range(1, 9))
def test_every_robot_is_dealt_once_in_even_blocks_of_neighbours(robots: int) -> None:
    for clients in range(1, robots + 1):
        blocks = partition_robots(robots, clients)
        assert [robot for block in blocks for robot in block] == list(range(robots))
        sizes = {len(block) for block in blocks}
        assert max(sizes) - min(sizes) <= 1
        assert len(blocks) == clients


def test_nodes_are_taken_in_the_order_of_their_numbers() -> None:
    assert wait_for_nodes(cast(Grid, FakeGrid(5)), 3, 1.0) == [100, 101, 102]


def test_a_federation_that_stays_too_small_is_an_error() -> None:
    with pytest.raises(RoundError, match=r"2 of 3 Flower clients were there after 0\.1 s"):
        wait_for_nodes(cast(Grid, FakeGrid(2)), 3, 0.1)


# --- The same weights, however windows fill rounds ------------------------------------------------


@pytest.mark.parametrize(
    ("clients", "per_round", "strategy"),
    [
        (3, 1, "fedavg"),
        (2, 4, "fedavg"),
        (1, None, "fedavg"),
        (2, 3, "none"),
        (2, 2, "fedprox"),
        (3, 1, "fedavgm"),
        (2, 4, "fedadam"),
        (2, 1, "fedmedian"),
    ],
)
def test_rounds_change_no_bit(
    on_flower: Tiny,
    make_fleet: Callable[..., FlowerFleet],
    play: Play,
    clients: int,
    per_round: int | None,
    strategy: str,
) -> None:
    config = on_flower(
        {
            "train.max_ticks": 60,
            "federation.windows_per_round": per_round,
            "strategy.name": strategy,
            **RATES.get(strategy, {}),
        }
    )
    expected = play(config)
    grid = FakeGrid(clients)
    fleet = make_fleet(config, grid)
    played = play(config, fleet=fleet)
    assert played.digests == expected.digests
    assert played.watcher.episodes == expected.watcher.episodes
    rounds = -(-6 // (per_round or 100))
    windows = [per_round * n if per_round else 0 for n in range(rounds)]
    for node in range(clients):
        assert [order["window"] for order in grid.orders(node)] == windows
        assert [order["round"] for order in grid.orders(node)] == list(range(1, rounds + 1))


def test_rounds_are_cut_where_the_run_ends(
    on_flower: Tiny, make_fleet: Callable[..., FlowerFleet], play: Play
) -> None:
    config = on_flower({"federation.windows_per_round": 4})
    flags = iter([False] * 4 + [True])
    grid = FakeGrid(2)
    played = play(config, fleet=make_fleet(config, grid), stop=lambda: next(flags))
    assert played.run.progress.window == 5
    assert [order["window"] for order in grid.orders(0)] == [0, 4]
    flags = iter([False] * 4 + [True])
    assert played.digests == play(config, stop=lambda: next(flags)).digests


def test_a_message_holds_what_its_node_needs_and_no_other_robots_secret(
    on_flower: Tiny, make_fleet: Callable[..., FlowerFleet], play: Play
) -> None:
    config = on_flower({"federation.windows_per_round": 5})
    grid = FakeGrid(2)
    play(config, fleet=make_fleet(config, grid))
    first, second = grid.orders(0)
    assert (first["robots"], grid.orders(1)[0]["robots"]) == ([0, 1], [2])
    order = RoundConfig.read(first)
    assert order.config == config
    assert order.address[0] == "127.0.0.1"
    tokens = [
        token for node in (0, 1) for o in grid.orders(node) for token in cast(Any, o["tokens"])
    ]
    assert len(set(tokens)) == len(tokens) == 6
    assert {message.metadata.message_type for message in grid.sent} == {"train"}
    assert [message.metadata.group_id for message in grid.sent] == ["1", "1", "2", "2"]
    assert [list(m.content.array_records["arrays"]) for m in grid.sent] == [["model"]] * 4
    assert second["window"] == 5


def test_without_a_strategy_only_the_first_message_holds_a_model(
    on_flower: Tiny, make_fleet: Callable[..., FlowerFleet], play: Play
) -> None:
    config = on_flower({"federation.windows_per_round": 5, "strategy.name": "none"})
    grid = FakeGrid(1)
    play(config, fleet=make_fleet(config, grid))
    sent = [list(message.content.array_records["arrays"]) for message in grid.sent]
    assert sent == [["model"], []]


def test_costs_add_up_over_rounds(
    on_flower: Tiny, make_fleet: Callable[..., FlowerFleet], play: Play
) -> None:
    config = on_flower({"federation.windows_per_round": 5})
    fleet = make_fleet(config, FakeGrid(2))
    play(config, fleet=fleet)
    costs = fleet.costs()
    weights = 2 * 4 * robot_network(config).parameters
    assert costs.flower_bytes == 2 * (2 * weights + 3 * weights)  # a model a node, 3 uploads
    assert costs.flower_s > 0
    assert costs.client_cpu_s > 0
    assert costs.bytes_from_robots > 8 * 3 * weights


# --- What a client keeps between rounds -----------------------------------------------------------


def test_state_files_carry_each_robot_from_round_to_round(
    on_flower: Tiny, make_fleet: Callable[..., FlowerFleet], play: Play
) -> None:
    config = on_flower({"federation.windows_per_round": 2, "train.max_ticks": 60})
    play(config, fleet=make_fleet(config, FakeGrid(2)))
    for robot in range(3):
        assert sorted(robot_windows(Path(str(config.run.dir)) / "state", robot)) == [2, 4, 6]


def test_a_robot_whose_state_is_gone_fails_the_run_by_name(
    on_flower: Tiny, make_fleet: Callable[..., FlowerFleet], play: Play
) -> None:
    config = on_flower({"federation.windows_per_round": 2})
    folder = round_folder(Path(str(config.run.dir)) / "state", 2)

    def forgetful(message: Message, context: Context) -> Message:
        for file in folder.glob("checkpoint-*"):
            file.unlink()
        return train(message, context)

    fleet = make_fleet(config, FakeGrid(2, {1: forgetful}))
    with pytest.raises(RoundError, match=r"round 2: .* robot 2 failed: .*no checkpoint"):
        play(config, fleet=fleet)


# --- What can go wrong ----------------------------------------------------------------------------


def broken(message: Message, context: Context) -> Message:
    raise OSError("no space left on device")


def silent(message: Message, context: Context) -> None:
    return None


def test_a_client_that_fails_at_its_start_is_named_with_its_reason(
    on_flower: Tiny, make_fleet: Callable[..., FlowerFleet], play: Play
) -> None:
    config = on_flower()
    with pytest.raises(
        RoundError, match=r"round 1: the Flower client of robots 0, 1 failed: OSError: no space"
    ):
        play(config, fleet=make_fleet(config, FakeGrid(2, {0: broken, 1: silent})))


def test_a_client_that_never_connects_is_named_at_the_deadline(
    on_flower: Tiny, make_fleet: Callable[..., FlowerFleet], play: Play
) -> None:
    config = on_flower({"runtime.start_timeout_s": 1.0})
    with pytest.raises(RoundError, match=r"round 1: robot 2 did.*does the federation run 2"):
        play(config, fleet=make_fleet(config, FakeGrid(2, {1: silent})))


def test_a_client_that_serves_and_never_replies_is_named_at_the_deadline(
    on_flower: Tiny, make_fleet: Callable[..., FlowerFleet], play: Play
) -> None:
    config = on_flower({"train.max_ticks": 20})

    def mute(message: Message, context: Context) -> None:
        train(message, context)

    fleet = make_fleet(config, FakeGrid(2, {0: mute}))

    def all_are_there() -> bool:
        fleet._config = on_flower({"runtime.start_timeout_s": 0.3})
        return False

    with pytest.raises(RoundError, match="round 1: no reply from robots 0, 1"):
        play(config, fleet=fleet, stop=all_are_there)


@pytest.mark.parametrize("kind", ["shape", "type"])
def test_weights_of_a_wrong_shape_or_type_are_refused_by_name(
    on_flower: Tiny, make_fleet: Callable[..., FlowerFleet], play: Play, kind: str
) -> None:
    config = on_flower({"train.max_ticks": 20})

    def crooked(message: Message, context: Context) -> Message:
        good = train(message, context).content.array_records["arrays"]["robots"].numpy()
        bad = good[:, :, :-1] if kind == "shape" else good.astype(np.float64)
        arrays = ArrayRecord({"robots": Array(np.ascontiguousarray(bad))})
        content = RecordDict({"arrays": arrays, "metrics": MetricRecord({"cpu_s": 0.0})})
        return Message(content, reply_to=message)

    with pytest.raises(
        RoundError, match=r"round 1: robot 2 replied wrongly: weights float(32|64) of shape"
    ):
        play(config, fleet=make_fleet(config, FakeGrid(2, {1: crooked})))


def test_a_client_that_breaks_off_in_the_middle_is_named(
    on_flower: Tiny, make_fleet: Callable[..., FlowerFleet], play: Play, monkeypatch: Any
) -> None:
    step = RobotGroup.step

    def failing(self: RobotGroup, told: Any) -> Any:
        if told.tick == 13 and 2 in self.robots:
            raise MemoryError("out of memory")
        return step(self, told)

    monkeypatch.setattr(RobotGroup, "step", failing)
    config = on_flower()
    with pytest.raises(LinkError, match=r"robot 2 failed .*MemoryError: out of memory"):
        play(config, fleet=make_fleet(config, FakeGrid(2)))


def test_a_client_of_another_build_is_refused(
    on_flower: Tiny, make_fleet: Callable[..., FlowerFleet], play: Play
) -> None:
    config = on_flower()

    def outdated(message: Message, context: Context) -> Message:
        order = RoundConfig.read(message.content.config_records["order"])
        given = (order.address, order.robots, order.tokens)
        robots = CheckpointedRobots(order.config, order.robots, None)
        serve(*given, robots, fingerprint="old", timeout_s=5, n_parameters=robots.parameters)
        raise AssertionError("it was let in")

    with pytest.raises(RoundError, match=r"robot 2 failed: Refused: .*old"):
        play(config, fleet=make_fleet(config, FakeGrid(2, {1: outdated})))


@pytest.mark.parametrize("names", [[], ["0"], ["0", None]], ids=["too_large", "left_out", "none"])
def test_a_grid_that_does_not_take_every_message_is_an_error(
    on_flower: Tiny, make_fleet: Callable[..., FlowerFleet], play: Play, names: list[Any]
) -> None:
    class Full(FakeGrid):
        def push_messages(self, messages: Iterable[Message]) -> Iterable[str]:
            return names

    config = on_flower()
    with pytest.raises(RoundError, match=f"Flower took {names.count('0')} of 2 messages"):
        play(config, fleet=make_fleet(config, Full(2)))


def test_a_client_whose_process_died_before_it_joined_is_a_lost_robot_and_said_in_one_line(
    on_flower: Tiny, make_fleet: Callable[..., FlowerFleet], play: Play
) -> None:
    """As Flower's simulation engine says it: the launcher then starts the run's processes anew."""

    def killed(message: Message, context: Context) -> Message:
        raise RuntimeError("<class 'ray.exceptions.ActorDiedError'>:<'The actor died\n\tpid: 1'>")

    config = on_flower()
    with pytest.raises(RobotLost) as lost:
        play(config, fleet=make_fleet(config, FakeGrid(2, {0: killed, 1: silent})))
    assert str(lost.value) == (
        "robots 0, 1 lost in round 1, which began after window 0: its process died without a word"
    )
