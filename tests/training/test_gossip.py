"""Mixing along a graph: doubly stochastic, exact where all agree, FedAvg's bits where all meet."""

from __future__ import annotations

import numpy as np
import pytest
from flwr.serverapp.strategy import FedAvg
from hypothesis import given
from hypothesis import strategies as st

from conf import StrategyConfig
from training.aggregation.aggregator import Aggregator
from training.aggregation.gossip import Gossip, mean_degree, metropolis, neighbours
from training.exchange.facts import WindowFacts
from training.exchange.federation import build_federation

GRAPHS = ("ring", "complete", "random")


def gossip(graph: str, degree: int = 1) -> StrategyConfig:
    return StrategyConfig(name="gossip", graph=graph, degree=degree)


def uploads(robots: int) -> np.ndarray:
    return np.random.default_rng(robots).normal(size=(robots, 2, 57)).astype(np.float32)


@given(
    graph=st.sampled_from(GRAPHS),
    robots=st.integers(2, 12),
    degree=st.integers(1, 3),
    seed=st.integers(0, 99),
    window=st.integers(1, 99),
)
def test_every_matrix_is_symmetric_and_doubly_stochastic(graph, robots, degree, seed, window):
    edges = neighbours(gossip(graph, degree), robots, seed, window)
    assert (edges == edges.T).all()
    assert not edges.diagonal().any()
    matrix = metropolis(edges)
    assert (matrix >= 0).all()
    assert (matrix == matrix.T).all()
    assert ((matrix > 0) == (edges | np.eye(robots, dtype=bool) & (matrix > 0))).all()
    np.testing.assert_allclose(matrix.sum(axis=0), 1, rtol=0, atol=1e-15)


@pytest.mark.parametrize("graph", GRAPHS)
@pytest.mark.parametrize("robots", [2, 3, 7, 33])
def test_robots_that_agree_keep_their_weights_to_the_bit(graph, robots):
    rows = np.repeat(uploads(2)[:1], robots, axis=0)
    mixed = Gossip(gossip(graph), 0).mix(1, rows)
    assert mixed.tobytes() == rows.tobytes()


@pytest.mark.parametrize(("graph", "robots"), [("complete", 7), ("complete", 2), ("ring", 3)])
def test_where_everybody_hears_everybody_all_get_the_bits_of_fedavg(graph, robots):
    rows = uploads(robots)
    expected = Aggregator(FedAvg(), robots).aggregate(1, rows[0], rows)
    for row in Gossip(gossip(graph), 0).mix(1, rows):
        assert row.tobytes() == expected.tobytes()


@pytest.mark.parametrize("graph", GRAPHS)
def test_mixing_keeps_the_mean_and_brings_robots_closer_to_it(graph):
    rows, mixer = uploads(6), Gossip(gossip(graph), 3)
    mixed = rows
    for window in range(1, 40):
        mixed = mixer.mix(window, mixed)
    np.testing.assert_allclose(mixed.mean(axis=0), rows.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(mixed, np.broadcast_to(rows.mean(axis=0), rows.shape), atol=0.05)


def test_a_ring_mixes_each_robot_with_the_two_beside_it():
    rows = uploads(5)
    mixed = Gossip(gossip("ring"), 0).mix(1, rows)
    wide = rows.astype(np.float64)
    np.testing.assert_allclose(mixed[0], (wide[4] + wide[0] + wide[1]) / 3, atol=1e-7)


def test_random_graphs_are_of_seed_and_window_alone():
    one, again, other, later = (
        neighbours(gossip("random", 2), 9, seed, window)
        for seed, window in ((4, 7), (4, 7), (5, 7), (4, 8))
    )
    assert (one == again).all()
    assert (one != other).any()
    assert (one != later).any()
    assert (one.sum(axis=1) >= 2).all()


@pytest.mark.parametrize("graph", GRAPHS)
def test_the_mean_degree_is_that_of_the_graphs(graph):
    config = gossip(graph, 2 if graph == "random" else 1)
    drawn = [neighbours(config, 7, 0, window).sum() / 7 for window in range(1, 300)]
    assert mean_degree(config, 7) == pytest.approx(np.mean(drawn), abs=0.05)


def test_absurd_weights_are_refused_by_the_robots_name(tiny):
    rows, facts = uploads(3), WindowFacts(np.zeros(3), np.zeros((3, 24), int))
    rows[2, 0, 5] = np.inf
    federation = build_federation(tiny({"strategy.name": "gossip"}))
    with pytest.raises(ValueError, match=r"window 6: absurd weights from robot 2 \(inf\)"):
        federation.exchange(6, uploads(3), rows, facts)
