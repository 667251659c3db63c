"""Aggregation through Flower's strategies: each rule against NumPy, and what must not leak."""

from __future__ import annotations

import dataclasses
import io
import logging
import math
import random
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest
import torch
from flwr.app import ArrayRecord, ConfigRecord, Message, MetricRecord
from flwr.serverapp import Grid
from flwr.serverapp.strategy import (
    FedAdagrad,
    FedAdam,
    FedAvg,
    FedAvgM,
    FedMedian,
    FedProx,
    FedTrimmedAvg,
    FedYogi,
    Krum,
    MultiKrum,
)
from flwr.supercore.task_identity import TaskIdentity
from hypothesis import given
from hypothesis.extra import numpy as hnp
from omegaconf import OmegaConf

import conf
from agent.networks.limits import WEIGHT_LIMIT, magnitude
from conf import Config, StrategyConfig
from conf.strategy_checks import KEYS
from env.validate import Problem, value_problems
from training.aggregation.aggregator import Aggregator
from training.aggregation.flower_round import WeightRows
from training.aggregation.strategies import STRATEGIES, build_aggregator

P = 203

YAML_FILES = sorted((Path(conf.__file__).parent / "strategy").glob("*.yaml"))

RULES: dict[str, tuple[Callable[[], FedAvg], bool]] = {
    "fedavg": (FedAvg, False),
    "fedprox": (lambda: FedProx(proximal_mu=0.01), False),
    "fedmedian": (FedMedian, False),
    "fedtrimmedavg": (FedTrimmedAvg, False),
    "krum": (Krum, False),
    "multikrum": (lambda: MultiKrum(num_nodes_to_select=2), False),
    "fedavgm": (lambda: FedAvgM(server_learning_rate=0.5, server_momentum=0.9), True),
    "fedadam": (FedAdam, True),
    "fedadagrad": (FedAdagrad, True),
    "fedyogi": (FedYogi, True),
}


def problems(config: StrategyConfig, robots: int) -> list[Problem]:
    """What is wrong with a run of this strategy and so many robots."""
    env = dataclasses.replace(Config().env, robots=robots)
    return conf.problems(dataclasses.replace(Config(), env=env, strategy=config))


def aggregator(rule: str, robots: int) -> Aggregator:
    build, online = RULES[rule]
    return Aggregator(build(), robots, online=online)


def weights(robots: int, seed: int = 0, spread: float = 0.01) -> tuple[WeightRows, WeightRows]:
    """What a window starts from, (2, P), and what it ends in, (K, 2, P)."""
    rng = np.random.default_rng(seed)
    current = rng.normal(size=(2, P)).astype(np.float32)
    moved = current + spread * rng.normal(size=(robots, 2, P))
    return current, moved.astype(np.float32)


def fedadam(**changes: float) -> StrategyConfig:
    """A configuration of ``fedadam`` that is sound but for the changes."""
    sound = {"server_rate": 0.001, "beta_1": 0.9, "beta_2": 0.99, "tau": 0.001}
    return StrategyConfig(name="fedadam", **{**sound, **changes})


def play(
    aggregate: Aggregator, windows: Iterable[int], current: WeightRows, robots: int
) -> WeightRows:
    """Several windows, each robot moving by a step that depends on robot and window alone."""
    for window in windows:
        steps = np.random.default_rng(window).normal(size=(robots, 2, P))
        current = aggregate.aggregate(window, current, (current + steps).astype(np.float32))
    return current


# --- The rules ------------------------------------------------------------------------------------


def test_the_mean_of_eq_12_by_hand() -> None:
    moved = np.array(
        [[[1, 2], [0, 1]], [[2, 4], [3, 1]], [[6, 0], [3, 4]]], dtype=np.float32
    )  # three robots' online and target weights
    found = aggregator("fedavg", 3).aggregate(1, np.zeros((2, 2), dtype=np.float32), moved)
    # (1 + 2 + 6) / 3, (2 + 4 + 0) / 3; (0 + 3 + 3) / 3, (1 + 1 + 4) / 3.
    assert found.tolist() == [[3, 2], [2, 2]]


@pytest.mark.parametrize("rule", ["fedavg", "fedprox"])
@pytest.mark.parametrize("robots", [1, 2, 3, 7])
def test_the_mean_is_within_half_an_ulp_of_the_exact_mean(rule: str, robots: int) -> None:
    current, uploads = weights(robots, spread=1.0)
    result = aggregator(rule, robots).aggregate(1, current, uploads)
    columns = uploads.reshape(robots, -1).T
    exact = np.array([math.fsum(column) for column in columns]) / robots
    half_ulp = np.spacing(np.abs(exact).astype(np.float32)).astype(np.float64) / 2
    assert result.dtype == np.float32
    assert (np.abs(result.ravel().astype(np.float64) - exact) <= half_ulp * (1 + 1e-6)).all()


@pytest.mark.parametrize("rule", ["fedavg", "krum"])
@pytest.mark.parametrize("robots", [1, 3, 7, 33])
def test_equal_uploads_come_back_bit_for_bit(rule: str, robots: int) -> None:
    current, _ = weights(robots)
    current[0, :4] = [1e-45, -0.0, np.nextafter(np.float32(WEIGHT_LIMIT), np.float32(0)), 1 / 3]
    uploads = np.repeat(current[None], robots, axis=0)
    result = aggregator(rule, robots).aggregate(1, np.zeros_like(current), uploads)
    assert result.tobytes() == current.tobytes()


def test_the_median_is_taken_element_by_element_on_both_rows() -> None:
    current, uploads = weights(4)
    result = aggregator("fedmedian", 4).aggregate(1, current, uploads)
    expected = np.median(uploads.astype(np.float64), axis=0).astype(np.float32)
    np.testing.assert_array_equal(result, expected)


def test_the_trimmed_mean_drops_the_extremes_of_both_rows() -> None:
    current, uploads = weights(5)
    result = aggregator("fedtrimmedavg", 5).aggregate(1, current, uploads)
    inner = np.sort(uploads.astype(np.float64), axis=0)[1:4]
    np.testing.assert_allclose(result, inner.mean(axis=0), rtol=1e-7)


def test_fedavgm_moves_online_weights_by_momentum_and_means_the_targets() -> None:
    rate, momentum, robots = 0.5, 0.9, 3
    aggregate = aggregator("fedavgm", robots)
    current, _ = weights(robots)
    server, velocity = current[0].astype(np.float64), np.zeros(P)
    for window in range(1, 6):
        _, uploads = weights(robots, seed=window)
        current = aggregate.aggregate(window, current, uploads)
        mean = uploads.astype(np.float64).mean(axis=0)
        velocity = momentum * velocity + (server - mean[0])
        server = server - rate * velocity
        np.testing.assert_allclose(current[0], server, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(current[1], mean[1], rtol=1e-7)


def test_fedadam_reads_the_window_and_leaves_the_targets_to_the_mean() -> None:
    eta, beta_1, beta_2, tau, robots = 0.1, 0.9, 0.99, 1e-3, 3
    aggregate = aggregator("fedadam", robots)
    current, _ = weights(robots)
    first, second = np.zeros(P), np.zeros(P)
    for window in range(1, 6):
        _, uploads = weights(robots, seed=window)
        mean = uploads.astype(np.float64).mean(axis=0)
        delta = mean[0] - current[0]
        first = beta_1 * first + (1 - beta_1) * delta
        second = beta_2 * second + (1 - beta_2) * delta**2
        # Flower corrects window t as Adam corrects step t + 1.
        step = eta * np.sqrt(1 - beta_2 ** (window + 1)) / (1 - beta_1 ** (window + 1))
        expected = current[0] + step * first / (np.sqrt(second) + tau)
        current = aggregate.aggregate(window, current, uploads)
        np.testing.assert_allclose(current[0], expected, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(current[1], mean[1], rtol=1e-7)


@pytest.mark.parametrize("rule", [name for name, (_, online) in RULES.items() if online])
def test_server_optimisers_give_the_targets_of_the_plain_mean(rule: str) -> None:
    current, uploads = weights(3)
    plain = aggregator("fedavg", 3).aggregate(1, current, uploads)
    result = aggregator(rule, 3).aggregate(1, current, uploads)
    np.testing.assert_array_equal(result[1], plain[1])
    assert not np.array_equal(result[0], plain[0])


def test_krum_takes_one_robots_pair_exactly() -> None:
    current, uploads = weights(5)
    uploads[3] += 50
    result = aggregator("krum", 5).aggregate(1, current, uploads)
    chosen = [robot for robot in range(5) if uploads[robot].tobytes() == result.tobytes()]
    distances = ((uploads[:, None] - uploads[None]).astype(np.float64) ** 2).sum(axis=(2, 3))
    scores = np.sort(distances, axis=1)[:, 1:4].sum(axis=1)
    assert chosen == [int(np.argmin(scores))]


def test_krum_sees_differences_far_below_the_norm_of_the_weights() -> None:
    current, uploads = weights(5, spread=0)
    rng = np.random.default_rng(1)
    for robot, spread in enumerate((2e-4, 2e-4, 1e-5, 2e-4, 3e-4)):
        uploads[robot] += (spread * rng.normal(size=(2, P))).astype(np.float32)
    result = aggregator("krum", 5).aggregate(1, current, uploads)
    assert result.tobytes() == uploads[2].tobytes()


# --- What must not matter, and what must not leak -------------------------------------------------


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("robots", [1, 3])
def test_every_rule_works_and_gives_finite_float32(rule: str, robots: int) -> None:
    current, uploads = weights(robots)
    before = current.copy(), uploads.copy()
    result = aggregator(rule, robots).aggregate(1, current, uploads)
    assert result.dtype == np.float32
    assert result.shape == (2, P)
    assert np.isfinite(result).all()
    result += 1  # the caller's own: nothing below may share its memory
    np.testing.assert_array_equal(current, before[0])
    np.testing.assert_array_equal(uploads, before[1])


@pytest.mark.parametrize("rule", RULES)
def test_two_aggregators_agree_bit_for_bit_whatever_the_global_seed(rule: str) -> None:
    current, _ = weights(7)
    results = []
    for seed in (1, 2):
        random.seed(seed)
        results.append(play(aggregator(rule, 7), range(1, 5), current, 7))
    assert results[0].tobytes() == results[1].tobytes()


class Spy(FedAvg):
    """Keeps what passes between Flower and the adapter."""

    def configure_train(
        self, server_round: int, arrays: ArrayRecord, config: ConfigRecord, grid: Grid
    ) -> Iterable[Message]:
        """Keeps the messages to the nodes."""
        self.told = list(super().configure_train(server_round, arrays, config, grid))
        return self.told

    def aggregate_train(
        self, server_round: int, replies: Iterable[Message]
    ) -> tuple[ArrayRecord | None, MetricRecord | None]:
        """Keeps the replies."""
        self.window, self.replies = server_round, list(replies)
        return super().aggregate_train(server_round, self.replies)


def test_replies_come_in_the_order_of_the_robots_however_flower_shuffles() -> None:
    current, uploads = weights(9)
    spy = Spy()
    aggregate = Aggregator(spy, 9)
    random.seed(3)
    aggregate.aggregate(4, current, uploads)
    assert [message.metadata.dst_node_id for message in spy.told] != list(range(1, 10))
    assert [reply.metadata.src_node_id for reply in spy.replies] == list(range(1, 10))
    assert spy.window == 4
    for reply, upload in zip(spy.replies, uploads, strict=True):
        (record,) = reply.content.array_records.values()
        np.testing.assert_array_equal(record["weights"].numpy(), upload)


@pytest.mark.parametrize("rule", RULES)
def test_no_global_random_state_is_touched(rule: str) -> None:
    def numpy_state() -> str:
        with np.printoptions(threshold=1000):
            return repr(np.random.get_state())  # noqa: NPY002

    before = random.getstate(), numpy_state(), torch.get_rng_state()
    play(aggregator(rule, 3), range(1, 4), weights(3)[0], 3)
    assert random.getstate() == before[0]
    assert numpy_state() == before[1]
    assert torch.equal(torch.get_rng_state(), before[2])


def test_flower_is_silent_within_a_call_and_logs_again_after_it() -> None:
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    logger = logging.getLogger("flwr")
    logger.addHandler(handler)
    try:
        play(aggregator("fedadam", 3), range(1, 3), weights(3)[0], 3)
        assert stream.getvalue() == ""
        logger.info("said afterwards")
        assert "said afterwards" in stream.getvalue()
    finally:
        logger.removeHandler(handler)
    assert not logger.filters


def test_a_task_identity_is_lent_where_there_is_none_and_kept_where_there_is() -> None:
    assert TaskIdentity._run_id is None
    current, uploads = weights(3)
    aggregator("fedavg", 3).aggregate(1, current, uploads)
    assert TaskIdentity._run_id is None
    try:
        TaskIdentity.run_id, TaskIdentity.task_id, TaskIdentity.node_id = 77, 8, 9
        aggregator("fedavg", 3).aggregate(1, current, uploads)
        assert (TaskIdentity.run_id, TaskIdentity.task_id, TaskIdentity.node_id) == (77, 8, 9)
    finally:
        TaskIdentity._run_id = TaskIdentity._task_id = TaskIdentity._node_id = None


# --- Bad input ------------------------------------------------------------------------------------


@pytest.mark.parametrize("rule", ["fedavg", "krum", "fedadam"])
@pytest.mark.parametrize(
    ("bad", "shown"),
    [
        (np.nan, "nan"),
        (np.inf, "inf"),
        (-np.inf, "inf"),
        (-1.01 * WEIGHT_LIMIT, r"1\.01e\+04"),
        (3e38, r"3e\+38"),
    ],
)
def test_an_absurd_upload_names_its_robot_and_value_and_changes_nothing(
    rule: str, bad: float, shown: str
) -> None:
    current, uploads = weights(3)
    aggregate = aggregator(rule, 3)
    expected = aggregator(rule, 3).aggregate(1, current, uploads)
    broken = uploads.copy()
    broken[1, 1, 5] = bad
    with pytest.raises(
        ValueError, match=rf"window 1: .* from robot 1 \({shown}\), of robots 0 to 2"
    ):
        aggregate.aggregate(1, current, broken)
    np.testing.assert_array_equal(aggregate.aggregate(1, current, uploads), expected)


def test_all_robots_with_absurd_weights_are_named() -> None:
    current, uploads = weights(4)
    uploads[1, 0, 0], uploads[3, 1, 2] = np.nan, 1e6
    with pytest.raises(ValueError, match=r"robot 1 \(nan\), robot 3 \(1e\+06\), of"):
        aggregator("fedavg", 4).aggregate(2, current, uploads)


def test_weights_at_the_limit_are_taken() -> None:
    current, uploads = weights(3)
    uploads[0, 0, 0], uploads[1, 1, 1] = WEIGHT_LIMIT, -WEIGHT_LIMIT
    assert np.isfinite(aggregator("fedavg", 3).aggregate(1, current, uploads)).all()


@given(hnp.arrays(np.float32, hnp.array_shapes(max_dims=3, max_side=6)))
def test_the_magnitude_is_the_largest_and_nan_is_not_missed(array: WeightRows) -> None:
    with np.errstate(invalid="ignore"):
        found = magnitude(array)
    assert np.isnan(found) if np.isnan(array).any() else found == np.abs(array).max()


def test_a_result_beyond_float32_is_an_error_that_names_the_strategy() -> None:
    current, uploads = weights(3)
    current[0, 0] = -np.finfo(np.float32).max
    aggregate = Aggregator(FedAvgM(server_learning_rate=4.0), 3, online=True)
    with pytest.raises(ArithmeticError, match=r"FedAvgM .* window 6"):
        aggregate.aggregate(6, current, uploads)


def test_wrong_windows_shapes_and_fleets_are_refused() -> None:
    current, uploads = weights(3)
    aggregate = aggregator("fedavg", 3)
    with pytest.raises(ValueError, match="numbered from 1"):
        aggregate.aggregate(0, current, uploads)
    with pytest.raises(ValueError, match=r"\(3, 2, P\) are expected"):
        aggregate.aggregate(1, current, uploads[:2])
    with pytest.raises(ValueError, match="at least 1"):
        Aggregator(FedAvg(), 0)


# --- State ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("rule", RULES)
def test_a_restored_aggregator_goes_on_to_the_same_bits(rule: str) -> None:
    whole = aggregator(rule, 3)
    halfway = play(whole, range(1, 4), weights(3)[0], 3)
    state = whole.state()
    frozen = {key: value.copy() for key, value in state.items()}
    expected = play(whole, range(4, 8), halfway, 3)
    resumed = aggregator(rule, 3)
    play(resumed, range(1, 3), weights(3, seed=9)[0], 3)  # leftovers that restore must clear
    resumed.restore(state)
    assert play(resumed, range(4, 8), halfway, 3).tobytes() == expected.tobytes()
    for key, value in frozen.items():  # state is a copy on both sides
        np.testing.assert_array_equal(state[key], value)
    for key, value in whole.state().items():
        np.testing.assert_array_equal(resumed.state()[key], value)


def test_only_server_optimisers_keep_anything() -> None:
    kept = {}
    for rule in RULES:
        aggregate = aggregator(rule, 3)
        assert aggregate.state() == {}
        play(aggregate, range(1, 3), weights(3)[0], 3)
        kept[rule] = {key.split("/")[0] for key in aggregate.state()}
    adaptive = {"current_arrays", "m_t", "v_t"}
    assert {rule: names for rule, names in kept.items() if names} == {
        "fedavgm": {"current_arrays", "momentum_vector"},
        "fedadam": adaptive,
        "fedadagrad": adaptive,
        "fedyogi": adaptive,
    }


def test_another_strategys_state_is_refused() -> None:
    aggregate = aggregator("fedadam", 3)
    play(aggregate, [1], weights(3)[0], 3)
    with pytest.raises(ValueError, match=r"FedAvg keeps no .*m_t"):
        aggregator("fedavg", 3).restore(aggregate.state())


# --- The group ``strategy`` -----------------------------------------------------------------------


def test_fedprox_has_the_mu_of_its_key() -> None:
    built = build_aggregator(StrategyConfig(name="fedprox", proximal_mu=0.25), 3)
    assert isinstance(built._strategy, FedProx)
    assert built._strategy.proximal_mu == 0.25


def test_each_strategy_has_a_file() -> None:
    assert {path.stem for path in YAML_FILES} == set(STRATEGIES)
    assert list(STRATEGIES) == list(KEYS)


@pytest.mark.parametrize("path", YAML_FILES, ids=lambda path: path.stem)
def test_each_file_fits_the_schema_and_builds(path: Path) -> None:
    schema = OmegaConf.structured(StrategyConfig)
    config = OmegaConf.to_object(OmegaConf.merge(schema, OmegaConf.load(path)))
    assert isinstance(config, StrategyConfig)
    assert config.name == path.stem
    if config.name == "own":
        assert [key for key, *_ in problems(config, 3)] == ["strategy.target"]
        config = dataclasses.replace(config, target="flwr.serverapp.strategy:FedTrimmedAvg")
    assert problems(config, 3) == []
    built = build_aggregator(config, 3)
    assert (built is None) == (path.stem in {"none", "gossip", "visits"})
    if built is not None:
        assert built.aggregate(1, *weights(3)).shape == (2, P)


@pytest.mark.parametrize(
    ("config", "made"),
    [
        (
            StrategyConfig(name="fedavgm", server_rate=0.25, momentum=0.75),
            {"server_learning_rate": 0.25, "server_momentum": 0.75},
        ),
        (
            fedadam(server_rate=0.002, beta_1=0.5, beta_2=0.75, tau=0.125),
            {"eta": 0.002, "beta_1": 0.5, "beta_2": 0.75, "tau": 0.125},
        ),
    ],
)
def test_a_server_optimiser_takes_its_rates_from_its_keys(
    config: StrategyConfig, made: dict[str, float]
) -> None:
    build = {"fedavgm": FedAvgM, "fedadam": FedAdam}[config.name]
    expected = Aggregator(build(**made), 3, online=True)
    built = build_aggregator(config, 3)
    assert built is not None
    for window in (1, 2, 3):
        current, uploads = weights(3, seed=window)
        result = built.aggregate(window, current, uploads)
        assert result.tobytes() == expected.aggregate(window, current, uploads).tobytes()


def test_the_default_is_the_papers_plain_mean() -> None:
    current, uploads = weights(3)
    built = build_aggregator(StrategyConfig(), 3)
    assert built is not None
    expected = aggregator("fedavg", 3).aggregate(1, current, uploads)
    np.testing.assert_array_equal(built.aggregate(1, current, uploads), expected)


@pytest.mark.parametrize(
    ("config", "robots", "key", "allowed"),
    [
        (
            StrategyConfig(name="fedsgd"),
            3,
            "strategy.name",
            "krum, multikrum, bulyan, own, visits, none",
        ),
        (StrategyConfig(name="krum"), 2, "strategy.name", "env.robots of at least 3, not 2"),
        (StrategyConfig(name="krum", malicious=2), 5, "strategy.malicious", "from 0 to 1"),
        (StrategyConfig(name="bulyan", malicious=1), 6, "strategy.malicious", "from 0 to 0"),
        (StrategyConfig(name="multikrum", selected=4), 3, "strategy.selected", "from 1 to"),
        (StrategyConfig(name="fedprox"), 3, "strategy.proximal_mu", "above 0"),
        (StrategyConfig(proximal_mu=0.1), 3, "strategy.proximal_mu", "only fedprox reads it"),
        (
            StrategyConfig(name="none", malicious=1),
            3,
            "strategy.malicious",
            "multikrum or bulyan reads it",
        ),
        (StrategyConfig(server_rate=0.5), 3, "strategy.server_rate", "only fedavgm or fedadam"),
        (StrategyConfig(name="fedmedian", tau=0.1), 3, "strategy.tau", "only fedadam reads it"),
        (StrategyConfig(name="fedavgm", beta_1=0.9), 3, "strategy.beta_1", "only fedadam reads it"),
        (fedadam(tau=0.0), 3, "strategy.tau", "a number above 0"),
        (StrategyConfig(graph="complete"), 3, "strategy.graph", "only gossip reads it"),
        (StrategyConfig(name="gossip"), 1, "strategy.name", "env.robots of at least 2, not 1"),
        (StrategyConfig(name="gossip", degree=2), 3, "strategy.degree", "only random reads it"),
        (
            StrategyConfig(name="gossip", graph="random", degree=3),
            3,
            "strategy.degree",
            "from 1 to 2 with env.robots=3",
        ),
    ],
)
def test_problems_name_the_key_and_what_is_allowed(
    config: StrategyConfig, robots: int, key: str, allowed: str
) -> None:
    ((found_key, value, found_allowed),) = problems(config, robots)
    assert found_key == key
    assert value is getattr(config, key.removeprefix("strategy."))
    assert allowed in found_allowed


@pytest.mark.parametrize(
    ("changes", "allowed"),
    [
        ({"malicious": -1}, "a number of at least 0"),
        ({"proximal_mu": math.nan}, "a finite number"),
        ({"server_rate": 0.0}, "a number above 0 and at most 10"),
        ({"server_rate": 11.0}, "a number above 0 and at most 10"),
        ({"server_rate": math.nan}, "a finite number"),
        ({"momentum": 1.0}, "a number of at least 0 and below 1"),
        ({"momentum": -0.1}, "a number of at least 0 and below 1"),
        ({"momentum": math.nan}, "a finite number"),
        ({"beta_1": 1.0}, "a number of at least 0 and below 1"),
        ({"beta_2": 1.0}, "a number of at least 0 and below 1"),
        ({"tau": math.inf}, "a finite number"),
    ],
)
def test_a_value_that_no_strategy_takes_is_refused_at_its_field(
    changes: dict[str, float], allowed: str
) -> None:
    found = list(value_problems(StrategyConfig(**changes), "strategy."))
    assert [(key, say) for key, _, say in found] == [(f"strategy.{next(iter(changes))}", allowed)]


def test_krum_is_allowed_up_to_its_bound() -> None:
    assert problems(StrategyConfig(name="krum", malicious=1), 5) == []
    assert problems(StrategyConfig(name="krum"), 3) == []
