"""Hostile robots: what each attack uploads, and that only uploads differ."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.networks.limits import WEIGHT_LIMIT
from conf import AttackConfig, Config, StrategyConfig
from training.aggregation.strategies import build_aggregator
from training.exchange.attacks import attack_of
from training.exchange.outbox import Outbox, outboxes


def hostile(name, robots=1, scale=2.0, seed=0):
    return dataclasses.replace(Config(), seed=seed, attack=AttackConfig(name, robots, scale))


def step(seed=0, size=40):
    rng = np.random.default_rng(seed)
    start = rng.normal(size=(2, size)).astype(np.float32)
    return start, (start + 0.01 * rng.normal(size=(2, size))).astype(np.float32)


def test_the_last_robots_are_hostile_and_by_default_nobody_is():
    config = hostile("flip", robots=2)
    assert [attack_of(config, robot) is None for robot in range(3)] == [True, False, False]
    assert outboxes(Config(), range(3), 40) == []
    assert len(outboxes(config, range(3), 40)) == 3


@given(st.floats(0.1, 100), st.integers(0, 50))
def test_flipped_and_scaled_steps_are_the_honest_one_times_the_scale(scale, seed):
    start, now = step(seed)
    for name, sign in (("flip", -1), ("scale", 1)):
        sent = attack_of(hostile(name, scale=scale), 2)(1, start, now)
        expected = start + sign * np.float32(scale) * (now - start)
        np.testing.assert_allclose(sent, expected, rtol=1e-5, atol=1e-5)


def test_noise_is_as_long_as_the_honest_step_times_the_scale_and_new_each_window():
    start, now = step(size=4000)
    noise = attack_of(hostile("noise", scale=5.0), 2)
    first, second = noise(1, start, now), noise(2, start, now)
    length = np.linalg.norm(first - start, axis=1) / np.linalg.norm(now - start, axis=1)
    np.testing.assert_allclose(length, 5.0, rtol=0.1)
    assert (first != second).any()
    np.testing.assert_array_equal(attack_of(hostile("noise", scale=5.0), 2)(1, start, now), first)


def test_two_hostile_robots_send_noise_of_their_own():
    start, now = step()
    config = hostile("noise", robots=2)
    assert (attack_of(config, 1)(1, start, now) != attack_of(config, 2)(1, start, now)).any()


def test_a_stale_robot_repeats_its_first_upload_also_from_a_checkpoint():
    config, (start, now) = hostile("stale", scale=1.0), step()
    box = Outbox(config, 2, 40)
    box.take(start)
    first = box.send(1, now)
    other = Outbox(config, 2, 40)
    other.restore(box.state())
    for later in (box, other):
        np.testing.assert_array_equal(later.send(2, now + 1), first)
    np.testing.assert_array_equal(first, now)


@pytest.mark.parametrize("name", ["flip", "scale"])
def test_no_attack_sends_what_the_server_would_refuse(name):
    start, now = step()
    sent = attack_of(hostile(name, scale=1000.0), 2)(1, start, now + 1000)
    assert np.abs(sent).max() == WEIGHT_LIMIT


def test_trimming_and_the_median_bound_what_one_of_four_can_do_and_the_mean_does_not():
    start, _ = step()
    rng = np.random.default_rng(1)
    uploads = (start + 0.01 * rng.normal(size=(4, *start.shape))).astype(np.float32)
    uploads[3] = 1000.0
    within = {}
    for config in (
        StrategyConfig("fedavg"),
        StrategyConfig("fedmedian"),
        StrategyConfig("fedtrimmedavg", trim=0.25),
        StrategyConfig("krum"),
    ):
        found = build_aggregator(config, 4).aggregate(1, start, uploads)
        honest = uploads[:3]
        within[config.name] = bool(((found >= honest.min(0)) & (found <= honest.max(0))).all())
    assert within == {"fedavg": False, "fedmedian": True, "fedtrimmedavg": True, "krum": True}


@pytest.mark.slow
def test_bulyan_without_hostile_robots_is_the_mean_and_with_one_of_seven_bounds_it():
    start, _ = step()
    rng = np.random.default_rng(1)
    uploads = (start + 0.01 * rng.normal(size=(7, *start.shape))).astype(np.float32)
    plain = build_aggregator(StrategyConfig("bulyan"), 7).aggregate(1, start, uploads)
    np.testing.assert_allclose(plain, uploads.mean(0, dtype=np.float64), rtol=1e-6)
    uploads[6] = 1000.0
    config = StrategyConfig("bulyan", malicious=1)
    found = build_aggregator(config, 7).aggregate(1, start, uploads)
    assert ((found >= uploads[:6].min(0)) & (found <= uploads[:6].max(0))).all()
