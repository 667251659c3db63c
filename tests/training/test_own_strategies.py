"""Strategies of the user's own: found by name, kept in checkpoints, refused in a sentence."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flwr.app import Array, ArrayRecord, ConfigRecord, Message, MetricRecord
from flwr.serverapp import Grid
from flwr.serverapp.strategy import FedAdam, FedAvg, FedTrimmedAvg, Strategy
from resume_helpers import check_goes_on

from conf import ConfigError, StrategyConfig
from experiments.cli import main
from repeatable.kept import Kept
from training.aggregation import own
from training.aggregation.aggregator import Aggregator
from training.aggregation.strategies import build_aggregator
from training.preflight import checked_training
from training.run_folder import RunFolder

TRIMMED = "flwr.serverapp.strategy:FedTrimmedAvg"


class Wandering(FedAvg):
    """The mean, and a step that depends on all that it has seen: every kind of thing is kept."""

    def __init__(self, size: float = 0.01) -> None:
        super().__init__()
        self.size, self.calls = size, 0
        self.drift: np.ndarray | None = None
        self.seen: list[np.ndarray] = []
        self.generator = np.random.default_rng(7)

    def aggregate_train(
        self, server_round: int, replies: Iterable[Message]
    ) -> tuple[ArrayRecord | None, MetricRecord | None]:
        arrays, metrics = super().aggregate_train(server_round, replies)
        assert arrays is not None
        ((name, array),) = arrays.items()
        mean = array.numpy()
        self.calls += 1
        drift = np.zeros_like(mean) if self.drift is None else self.drift
        self.drift = drift * 0.5 + self.generator.normal(size=mean.shape)
        self.seen = [*self.seen[-1:], mean]
        moved = mean + self.size * self.drift / self.calls + 0.1 * (self.seen[0] - mean)
        return ArrayRecord({name: Array(moved)}), metrics


class FirstAlone(Strategy):
    """No kin of FedAvg: it asks the first robot alone, and takes what that one says."""

    def configure_train(
        self, server_round: int, arrays: ArrayRecord, config: ConfigRecord, grid: Grid
    ) -> Iterable[Message]:
        messages = FedAvg().configure_train(server_round, arrays, config, grid)
        return [min(messages, key=lambda message: message.metadata.dst_node_id)]

    def aggregate_train(
        self, server_round: int, replies: Iterable[Message]
    ) -> tuple[ArrayRecord | None, MetricRecord | None]:
        (reply,) = replies
        return next(iter(reply.content.array_records.values())), None

    def configure_evaluate(self, *args: Any) -> Iterable[Message]:
        return []

    def aggregate_evaluate(self, *args: Any) -> None:
        return None

    def summary(self) -> None:
        return None


class Silent(FedAvg):
    """Gives arrays of another name."""

    def aggregate_train(
        self, server_round: int, replies: Iterable[Message]
    ) -> tuple[ArrayRecord | None, MetricRecord | None]:
        return ArrayRecord({"other": Array(np.zeros(3))}), None


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(own._STRATEGIES, "_registered", {})
    for name, strategy in (("wandering", Wandering), ("first", FirstAlone), ("silent", Silent)):
        own.register_strategy(name, strategy)


def config_of(target: str, **options: Any) -> StrategyConfig:
    return StrategyConfig(name="own", target=target, options=options)


def built(target: str, robots: int = 5, **options: Any) -> Aggregator:
    aggregator = build_aggregator(config_of(target, **options), robots)
    assert aggregator is not None
    return aggregator


def uploads(robots: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    current = rng.normal(size=(2, 11)).astype(np.float32)
    return current, (current + rng.normal(size=(robots, 2, 11))).astype(np.float32)


def test_any_strategy_of_flowers_is_had_by_its_place() -> None:
    current, sent = uploads(5)
    found = built(TRIMMED, beta=0.2).aggregate(1, current, sent)
    expected = Aggregator(FedTrimmedAvg(beta=0.2), 5).aggregate(1, current, sent)
    np.testing.assert_array_equal(found, expected)
    middle = np.sort(sent.astype(np.float64), axis=0)[1:-1].mean(axis=0)
    np.testing.assert_allclose(found, middle, rtol=1e-6)


def test_one_that_is_no_kin_of_fedavg_may_ask_fewer() -> None:
    current, sent = uploads(4)
    aggregator = built("first", 4)
    np.testing.assert_array_equal(aggregator.aggregate(1, current, sent), sent[0])
    assert aggregator.state() == {}


def test_the_scope_of_a_server_optimiser_leaves_targets_the_plain_mean() -> None:
    current, sent = uploads(3)
    config = StrategyConfig(name="own", target="wandering", scope="online")
    aggregator = build_aggregator(config, 3)
    assert aggregator is not None
    found = aggregator.aggregate(1, current, sent)
    mean = Aggregator(FedAvg(), 3).aggregate(1, current, sent)
    np.testing.assert_array_equal(found[1], mean[1])
    assert (found[0] != mean[0]).all()


def test_whatever_it_keeps_goes_on_as_if_it_had_not_been_interrupted() -> None:
    whole, first, second = built("wandering"), built("wandering"), built("wandering")
    current, _ = uploads(5)
    for window in range(1, 7):
        sent = uploads(5, window)[1]
        expected = whole.aggregate(window, current, sent)
        part = first if window <= 3 else second
        if window == 4:
            second.aggregate(1, current, uploads(5, 9)[1])  # which restoring must undo
            second.restore(first.state())
        np.testing.assert_array_equal(part.aggregate(window, current, sent), expected)
    names = {key.split("/")[0] for key in whole.state()}
    assert names == {"calls", "drift", "seen", "generator"}


class Sharing(FedAvg):
    """The mean, moved by an array that it holds under two names and changes in place."""

    def __init__(self) -> None:
        super().__init__()
        self.speed = [np.zeros(1)]
        self.by_name = {"speed": self.speed[0]}

    def aggregate_train(
        self, server_round: int, replies: Iterable[Message]
    ) -> tuple[ArrayRecord | None, MetricRecord | None]:
        arrays, metrics = super().aggregate_train(server_round, replies)
        assert arrays is not None
        self.speed[0] += 1
        ((name, array),) = arrays.items()
        return ArrayRecord({name: Array(array.numpy() + self.by_name["speed"])}), metrics


def test_arrays_that_attributes_share_are_no_other_after_a_resume() -> None:
    whole, first, second = (Aggregator(Sharing(), 2) for _ in range(3))
    current, sent = uploads(2)
    np.testing.assert_array_equal(
        whole.aggregate(1, current, sent), first.aggregate(1, current, sent)
    )
    second.restore(first.state())
    np.testing.assert_array_equal(
        second.aggregate(2, current, sent), whole.aggregate(2, current, sent)
    )


def test_a_run_with_one_resumes_to_the_same_bits(
    tiny_overrides: tuple[str, ...], tmp_path: Path
) -> None:
    keys = ["strategy=own", "strategy.target=wandering", "state.every=2"]
    whole = tmp_path / "whole"
    assert main(["train", *tiny_overrides, *keys, f"run.dir={whole}"]) == 0
    check_goes_on(whole, 6)


class Hoarding(FedAvg):
    """Keeps what a test puts there."""

    def __init__(self) -> None:
        super().__init__()
        self.by_node: dict[int, np.ndarray] = {}
        self.scale = np.float32(1.0)
        self.last: Any = None
        self.inner = FedAdam()
        self.words: set[str] = set()


def test_kinds_come_back_as_they_were() -> None:
    strategy, other = Hoarding(), Hoarding()
    kept, again = Kept(strategy), Kept(other)
    strategy.by_node = {3: np.arange(2.0), 1: np.arange(3.0)}
    strategy.scale = np.float32(0.1)
    strategy.last = [np.arange(4), np.zeros((0, 2))]
    strategy.inner.m_t = {"weights": np.arange(2.0)}
    again.restore(kept.state())
    assert list(other.by_node) == [3, 1]
    assert other.scale == np.float32(0.1)
    assert other.scale.dtype == np.float32
    assert [each.shape for each in other.last] == [(4,), (0, 2)]
    np.testing.assert_array_equal(other.inner.m_t["weights"], np.arange(2.0))
    again.restore({})
    assert (other.by_node, other.last, other.inner.m_t) == ({}, None, None)


def test_what_cannot_be_kept_is_named_once_it_changes() -> None:
    strategy = Hoarding()
    kept = Kept(strategy)
    assert kept.state() == {}
    strategy.words.add("new")
    with pytest.raises(ValueError, match=r"Hoarding\.words has changed"):
        kept.state()


def test_a_name_that_is_registered_is_no_other_processs() -> None:
    keys = ["strategy=own", "strategy.target=wandering"]
    checked_training(["runtime=local", *keys])
    with pytest.raises(ConfigError, match="with runtime=local a name that is registered"):
        checked_training(["runtime=simulation", *keys])


def test_weights_that_are_not_what_was_asked_for_are_named() -> None:
    current, sent = uploads(3)
    with pytest.raises(ValueError, match=r"Silent gave arrays of shapes \{'other': \(3,\)\}"):
        built("silent", 3).aggregate(1, current, sent)


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["strategy=own"], "strategy.target=null: allowed is an installed strategy's name"),
        (["strategy=own", "strategy.target=nothing"], "strategy.target=nothing: allowed is one of"),
        (["strategy=own", "strategy.target=no_such:Thing"], "ModuleNotFoundError"),
        (["strategy=own", "strategy.target=os:system"], "allowed is a class of Flower's Strategy"),
        (
            ["strategy=own", f"strategy.target={TRIMMED}", "strategy.options={gamma:1}"],
            "takes strategy.options={'gamma': 1}",
        ),
        (["strategy.options={beta:1}"], "strategy.options={'beta': 1}: allowed is null with"),
        (
            ["strategy=own", f"strategy.target={TRIMMED}", "strategy.options=3"],
            "strategy.options=3: allowed is a mapping",
        ),
        (["rooms.count=2", "rooms.strategy.name=own"], "strategy.target=null"),
    ],
)
def test_mistakes_cost_a_sentence(overrides: list[str], said: str) -> None:
    with pytest.raises(ConfigError) as refused:
        checked_training(["runtime=local", *overrides])
    assert said in str(refused.value)
    assert str(refused.value).count("\n") == 0


def test_the_command_takes_it_with_its_options(
    tiny_overrides: tuple[str, ...], tmp_path: Path
) -> None:
    keys = ["strategy=own", f"strategy.target={TRIMMED}", "strategy.options={beta:0.4}"]
    folder = tmp_path / "run"
    assert main(["train", *tiny_overrides, *keys, "train.max_ticks=20", f"run.dir={folder}"]) == 0
    config = RunFolder(folder).read_config()
    assert config.strategy == config_of(TRIMMED, beta=0.4)
