"""Runs of a wrapped strategy end in the same bits, however replies arrive."""

from __future__ import annotations

import random
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from flwr.app import ArrayRecord, ConfigRecord, Error, Message, MetricRecord
from flwr.clientapp import ClientApp
from flwr.common.constant import ErrorCode
from flwr.serverapp import Grid
from flwr.serverapp.strategy import (
    DifferentialPrivacyServerSideFixedClipping,
    FedAvg,
    FedAvgM,
    FedMedian,
    Krum,
    Strategy,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from repeatable_helpers import (
    APP,
    CLIENTS,
    answering,
    config,
    digest_of,
    fedadam,
    model,
    play,
    wrapped,
)

from repeatable import ClientLostError, LocalGrid, digest, generator, seeded
from repeatable.partitions import Partitions


def noisy_fedavg() -> Strategy:
    """One that draws from a global generator when it aggregates."""
    return DifferentialPrivacyServerSideFixedClipping(FedAvg(), 1.0, 1.0, 5)


MADE = {
    "fedadam": fedadam,
    "fedavg": FedAvg,
    "fedavgm": lambda: FedAvgM(server_momentum=0.5),
    "fedmedian": FedMedian,
    "krum": lambda: Krum(num_malicious_nodes=1),
    "noisy": noisy_fedavg,
}


@pytest.mark.parametrize("name", MADE)
def test_any_order_of_replies_and_any_numbers_of_nodes_give_the_same_bits(name: str) -> None:
    digests = {digest_of(wrapped(strategy=MADE[name]()), order=order) for order in range(4)}
    assert len(digests) == 1
    assert digest_of(wrapped(strategy=MADE[name]()), rounds=3) not in digests


@settings(max_examples=20)
@given(order=st.integers(0, 2**32), seed=st.integers(0, 2**63 - 2), clients=st.integers(2, 8))
def test_bits_depend_on_the_seed_and_not_on_the_order(order: int, seed: int, clients: int) -> None:
    draws = answering(lambda message, context: generator().normal(size=7).astype(np.float32))
    options: Any = {"app": draws, "clients": clients, "initial": model(7), "rounds": 1}
    first, second = (
        digest_of(wrapped(seed, strategy=FedAvg()), order=each, **options) for each in (0, order)
    )
    assert first == second
    assert digest_of(wrapped(seed + 1, strategy=FedAvg()), **options) != first


def test_flowers_own_strategies_give_other_bits_in_another_order() -> None:
    assert len({digest_of(FedAvg(), order=order) for order in range(8)}) > 1


def test_a_strategy_sees_the_same_nodes_in_every_run() -> None:
    seen = []

    class Looking(FedAvg):
        def configure_train(
            self, server_round: int, arrays: ArrayRecord, config: ConfigRecord, grid: Grid
        ) -> Iterable[Message]:
            seen.append([*grid.get_node_ids()])
            return super().configure_train(server_round, arrays, config, grid)

        def aggregate_train(
            self, server_round: int, replies: Iterable[Message]
        ) -> tuple[ArrayRecord | None, MetricRecord | None]:
            seen.append([reply.metadata.src_node_id for reply in replies])
            return super().aggregate_train(server_round, replies)

    play(wrapped(strategy=Looking()), rounds=1)
    assert seen == [[1, 2, 3, 4, 5]] * 2


def test_samples_come_from_the_seed() -> None:
    def asked(seed: int) -> list[set[int]]:
        rounds: list[set[int]] = [set() for _ in range(6)]

        def note(message: Message, context: Any) -> Any:
            number = int(message.content.config_records["config"]["server-round"])
            rounds[number - 1].add(context.node_config["partition-id"])
            return np.zeros((20, 5), dtype=np.float32)

        play(wrapped(seed), rounds=6, app=answering(note))
        return rounds

    first = asked(0)
    assert first == asked(0) != asked(1)
    assert {len(part) for part in first} == {3}
    assert len({*map(frozenset, first)}) > 1


def test_global_generators_are_left_as_they_were_on_both_sides() -> None:
    def drawing(message: Message, context: Any) -> Any:
        return [random.random(), np.random.rand()]  # noqa: NPY002

    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    first = digest_of(wrapped(strategy=noisy_fedavg()), app=answering(drawing), initial=model(2))
    drawn = random.random(), np.random.rand()  # noqa: NPY002
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    assert drawn == (random.random(), np.random.rand())  # noqa: NPY002
    again = digest_of(wrapped(strategy=noisy_fedavg()), app=answering(drawing), initial=model(2))
    assert first == again


def test_torch_is_seeded_where_it_is_there() -> None:
    torch = pytest.importorskip("torch")
    before = torch.get_rng_state()
    drawn = []
    for number in (1, 1, 2):
        with seeded(0, number):
            drawn.append(float(torch.rand(1)))
    assert drawn[0] == drawn[1] != drawn[2]
    assert (torch.get_rng_state() == before).all()


def test_a_client_that_fails_ends_the_run_with_its_name() -> None:
    def failing(message: Message, context: Any) -> Any:
        if context.node_config["partition-id"] == 3:
            raise OSError("disk full")
        return np.zeros((20, 5), dtype=np.float32)

    with pytest.raises(ClientLostError) as lost:
        play(wrapped(strategy=FedAvg()), app=answering(failing))
    assert str(lost.value) == "round 1: no result from partitions 3 (OSError: disk full)"


def test_a_round_in_which_a_client_was_lost_is_played_again_to_the_same_bits() -> None:
    failed: list[Any] = []

    def trained(fails: bool) -> Any:
        def train(message: Message, context: Any) -> Any:
            number = message.content.config_records["config"]["server-round"]
            if fails and number == 3 and len(failed) < 2:
                failed.append(number)
                raise OSError("cut off")
            return generator().normal(size=(20, 5)).astype(np.float32)

        return answering(train)

    due = digest_of(wrapped(), app=trained(False))
    assert digest_of(wrapped(retries=2), app=trained(True)) == due
    assert len(failed) == 2


def test_a_node_that_has_died_and_is_still_listed_is_left_out() -> None:
    class Haunted(LocalGrid):
        def get_node_ids(self) -> list[int]:
            return [7, *super().get_node_ids()]

        def _answer(self, message: Message) -> Message:
            if message.metadata.dst_node_id == 7:
                return Message(Error(ErrorCode.NODE_UNAVAILABLE), reply_to=message)
            return super()._answer(message)

    with Haunted(APP.client, CLIENTS, {"seed": 0}) as grid:
        found = wrapped().start(grid, model(), 2)
    assert digest(found.arrays) == digest_of(wrapped(), rounds=2)


def test_the_newest_node_of_a_partition_is_asked() -> None:
    with LocalGrid(APP.client, 2, seed=0) as grid:
        partitions = Partitions(None)
        old = partitions.nodes(grid)
        fresh = {7: grid._contexts[old[1]]}
        grid._contexts = grid._contexts | fresh
        assert partitions.nodes(grid) == {0: old[0], 1: 7}
        del grid._contexts[7]
        assert partitions.nodes(grid) == old


def test_an_app_without_the_kit_is_refused_in_a_sentence() -> None:
    with pytest.raises(ClientLostError, match="as one whose ClientApp is made by repeatable"):
        play(wrapped(), app=ClientApp())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"seed": -1}, "seed=-1: allowed is"),
        ({"seed": 2**63}, "a whole number from 0 to 2"),
        ({"retries": -1}, "retries=-1: allowed is"),
        ({"state": "here"}, "state-dir=here: allowed is an"),
    ],
)
def test_mistakes_in_the_kits_options_cost_a_sentence(options: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        wrapped(**options)


def test_a_strategy_that_sends_a_client_two_messages_is_refused() -> None:
    class Twice(FedAvg):
        def configure_train(self, *arguments: Any) -> Iterable[Message]:
            return [*super().configure_train(*arguments), *super().configure_train(*arguments)]

    with pytest.raises(ValueError, match="several messages at once"):
        play(wrapped(strategy=Twice()))


def test_results_are_those_of_flowers_start() -> None:
    judged = []

    def judge(number: int, arrays: ArrayRecord) -> MetricRecord:
        judged.append(number)
        return MetricRecord({"sum": float(arrays["weights"].numpy().sum())})

    result = play(wrapped(), rounds=2, evaluate_fn=judge, train_config=config(lr=0.1))
    assert [*result.evaluate_metrics_serverapp] == judged == [0, 1, 2]
    assert [*result.evaluate_metrics_clientapp] == [1, 2]
    assert result.evaluate_metrics_clientapp[2]["accuracy"] > 0.5
