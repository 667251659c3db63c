"""What stays a robot's own: exactly the layers that are meant, exactly the same function."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from agent import NetworkShape
from agent.networks.mlp import q_values
from conf import robot_network
from lockstep import Flag
from training.exchange.combining import build_combiner
from training.exchange.facts import WindowFacts
from training.exchange.own_parts import OwnNormalisation, shared_numbers
from training.exchange.reception import Heard
from training.partition import step_layout

Tiny = Callable[..., Any]
SHARED = {"heads": (1, 1, 0), "trunk": (0, 0, 1), "input": (0, 1, 1), "normalisation": (1, 1, 1)}


def facts(robots: int, actions: int = 4) -> WindowFacts:
    return WindowFacts(np.zeros(robots), np.ones((robots, actions), np.int64))


def networks(shape: NetworkShape, robots: int, seed: int = 0) -> np.ndarray:
    generator = np.random.default_rng(seed)
    return generator.normal(size=(robots, 2, shape.parameters)).astype(np.float32)


@pytest.mark.parametrize("own", SHARED)
def test_masks_cover_exactly_the_layers(own):
    shape = NetworkShape(4, (5, 6), 3)
    mask = shared_numbers(shape, own).astype(np.float32)
    for matrix, shared in zip(shape.matrices(mask), SHARED[own], strict=True):
        assert (matrix == shared).all()


@pytest.mark.parametrize("own", ["heads", "trunk", "input"])
def test_the_shared_part_becomes_the_mean_and_the_own_part_stays(tiny: Tiny, own):
    config = tiny({"federation.own": own})
    shape = robot_network(config)
    given, uploads = networks(shape, 3), networks(shape, 3, seed=1)
    combiner = build_combiner(config)
    assert combiner is not None
    found = combiner.combine(1, given, Heard(np.arange(3), uploads, np.arange(3)), facts(3))
    shared = shared_numbers(shape, own)
    mean = uploads.astype(np.float64).mean(axis=0)
    for robot in range(3):
        np.testing.assert_allclose(found[robot][:, shared], mean[:, shared], atol=1e-6)
        assert (found[robot][:, ~shared] == uploads[robot][:, ~shared]).all()


def test_a_robot_that_was_not_heard_takes_the_shared_part_and_goes_back_to_its_own(tiny: Tiny):
    config = tiny({"federation.own": "heads"})
    shape = robot_network(config)
    given, uploads = networks(shape, 3), networks(shape, 2, seed=1)
    combiner = build_combiner(config)
    assert combiner is not None
    found = combiner.combine(1, given, Heard(np.array([0, 2]), uploads, np.arange(3)), facts(3))
    shared = shared_numbers(shape, "heads")
    assert (found[:, :, shared] == found[0][:, shared]).all()
    assert (found[1][:, ~shared] == given[1][:, ~shared]).all()
    assert (found[2][:, ~shared] == uploads[1][:, ~shared]).all()


def test_gossip_gives_each_robot_its_own_and_leaves_those_that_nobody_heard(tiny: Tiny):
    config = tiny({"strategy.name": "gossip", "strategy.graph": "complete"})
    shape = robot_network(config)
    given, uploads = networks(shape, 3), networks(shape, 2, seed=1)
    combiner = build_combiner(config)
    assert combiner is not None
    found = combiner.combine(1, given, Heard(np.array([0, 1]), uploads, np.arange(3)), facts(3))
    assert found.shape == given.shape
    assert (found[0] == found[1]).all()
    assert (found[2] == given[2]).all()


@pytest.fixture
def normalisation(tiny: Tiny) -> tuple[OwnNormalisation, NetworkShape, np.ndarray]:
    """After 60 records of which robot 1 is driving in half, and what was observed in them."""
    config = tiny({"federation.own": "normalisation"})
    own, generator = OwnNormalisation(config), np.random.default_rng(5)
    seen = []
    for tick in range(60):
        updates = np.zeros(3, step_layout(config).record)
        updates["flags"] = Flag.DRIVING
        updates["flags"][1] *= tick % 2
        updates["cell"] = generator.integers(0, 48, 3)
        updates["channel_db"] = generator.normal(-70, 9, 3)
        own.observed(updates)
        seen.append(own._local.observe(updates["cell"], updates["channel_db"]))
    return own, robot_network(config), np.array(seen)


def test_moments_are_those_of_what_driving_robots_observed(normalisation):
    own, _, seen = normalisation
    mean, deviation = own.moments()
    for robot, rows in enumerate((seen[:, 0], seen[1::2, 1], seen[:, 2])):
        # as if one more had been observed, of mean 0 and square 1
        total, squares, count = rows.sum(axis=0), (rows**2).sum(axis=0) + 1, len(rows) + 1
        np.testing.assert_allclose(mean[robot], total / count, atol=1e-6)
        expected = np.sqrt(squares / count - (total / count) ** 2)
        np.testing.assert_allclose(deviation[robot], expected, atol=1e-6)


def test_a_normalised_network_is_the_same_function_of_normalised_observations(normalisation):
    own, shape, seen = normalisation
    rows = networks(shape, 3)
    mean, deviation = own.moments()
    observed = seen.swapaxes(0, 1)
    normalised = ((observed - mean[:, None]) / deviation[:, None]).astype(np.float32)
    shared = own.shared(rows, np.arange(3))
    before = q_values(shape, rows[:, 0], observed)
    np.testing.assert_allclose(
        q_values(shape, shared[:, 0], normalised), before, rtol=1e-3, atol=1e-3
    )
    alike = own.merged(rows, shared[0])
    given = np.repeat(shared[:1, 0], 3, axis=0)
    expected = q_values(shape, given, normalised)
    found = q_values(shape, alike[:, 0], observed)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3)
    assert not np.allclose(alike[0], alike[1])


def test_statistics_are_in_the_state(normalisation, tiny: Tiny):
    own, _, _ = normalisation
    fresh = OwnNormalisation(tiny({"federation.own": "normalisation"}))
    fresh.restore(own.state())
    assert all((a == b).all() for a, b in zip(fresh.moments(), own.moments(), strict=True))
