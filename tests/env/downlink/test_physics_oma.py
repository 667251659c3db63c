"""Downlink OMA, Baseline 2: equal parts of band and power, and nobody decodes for others."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from env.config import EnvConfig, OmaConfig, PowerConfig
from env.downlink import access
from env.downlink.allocation import Downlink

NOISE_W, MAX_POWER_W = 1e-13, 0.1
SHARES = ["fixed", "reallocate"]
gains = st.floats(0.0, 1e-3)


@st.composite
def slots(draw):
    """Gains, picks and who is served, for a few worlds."""
    shape = draw(st.integers(1, 4)), draw(st.integers(1, 6))
    generator = np.random.default_rng(draw(st.integers(0, 2**32)))
    gain = 10 ** generator.uniform(-16, -3, size=shape)
    return gain, generator.integers(1, 7, size=shape), generator.random(shape) < 0.7


@functools.cache
def downlink(robots, share, resolve="project", levels=6):
    power = PowerConfig(resolve=resolve, levels=levels)
    return Downlink(EnvConfig(robots=robots, access="oma", oma=OmaConfig(share), power=power))


def allocate(case, share, **options):
    return downlink(case[0].shape[1], share, **options).allocate(*case)


def test_rates_of_baseline_2_by_hand():
    gain, power = np.array([4.0, 2.0, 1.0]), np.array([0.5, 0.5, 0.25])
    # (1/3) log2(1 + 4 * 0.5 / (0.6 / 3)) and so on.
    expected = [math.log2(11) / 3, math.log2(6) / 3, math.log2(2.25) / 3]
    assert access.oma_rates(gain, power, 0.6, np.array([3])) == pytest.approx(expected)


def test_the_band_is_divided_into_as_many_parts_as_robots_or_as_drive():
    gain = np.array([[4e-12, 2e-12, 1e-12]])
    case = gain, np.array([[1, 2, 3]]), np.array([[True, False, True]])
    fixed, again = allocate(case, "fixed"), allocate(case, "reallocate")
    assert fixed.power_w[0] == pytest.approx([0.1 / 3, 0.0, 0.1 / 3])
    assert again.power_w[0] == pytest.approx([0.05, 0.0, 0.05])
    # P_max / n over sigma^2 / n is 1e12, whatever n is: SNRs of 4 and 1.
    assert fixed.rate[0] == pytest.approx([math.log2(5) / 3, 0.0, 1 / 3])
    assert again.rate[0] == pytest.approx([math.log2(5) / 2, 0.0, 1 / 2])
    assert fixed.order.tolist() == [[0, 2, 1]]


@given(st.lists(gains, min_size=1, max_size=6), st.floats(0, 1), st.integers(1, 64))
def test_rates_are_never_negative_and_grow_with_the_power(gain, power_w, parts):
    gain, parts = np.array(gain), np.array([parts])
    rate = access.oma_rates(gain, np.full(len(gain), power_w), NOISE_W, parts)
    assert (rate >= 0).all()
    assert (access.oma_rates(gain, np.full(len(gain), power_w + 0.1), NOISE_W, parts) >= rate).all()


@given(slots())
def test_no_robot_has_less_where_the_parts_of_those_that_arrived_are_dealt_out_again(case):
    fixed, again = allocate(case, "fixed"), allocate(case, "reallocate")
    assert (again.rate >= fixed.rate * (1 - 1e-12)).all()
    everybody = (*case[:2], np.ones_like(case[2]))
    same = [allocate(everybody, share).rate.tobytes() for share in SHARES]
    assert same[0] == same[1]


@given(slots(), st.sampled_from(SHARES), st.sampled_from(["project", "residual", "zero"]))
def test_the_budget_is_kept_and_nothing_fails_or_is_projected(case, share, resolve):
    found = allocate(case, share, resolve=resolve)
    assert (found.power_w.sum(axis=-1) <= MAX_POWER_W * (1 + 1e-12)).all()
    assert ((found.power_w > 0) == case[2]).all()
    assert ((found.rate > 0) <= case[2]).all()
    assert not found.sic_failed.any()
    assert not found.projected.any()
    assert not found.margin_dropped.any()


@given(slots(), st.sampled_from(SHARES))
def test_power_levels_have_no_effect_nor_has_what_others_channels_are(case, share):
    gain, picks, served = case
    found = allocate(case, share)
    assert allocate((gain, 7 - picks, served), share).rate.tobytes() == found.rate.tobytes()
    fading = gain.copy()
    fading[:, 1:] /= 2
    assert (allocate((fading, picks, served), share).rate[:, 0] == found.rate[:, 0]).all()


def test_more_robots_than_power_levels_are_served():
    case = np.full((1, 5), 1e-12), np.ones((1, 5), dtype=np.int64), np.ones((1, 5), dtype=bool)
    assert allocate(case, "fixed", levels=2).rate[0] == pytest.approx([1 / 5] * 5)


@pytest.mark.parametrize("share", SHARES)
def test_with_nobody_driving_nothing_is_sent(share):
    case = np.full((2, 3), 1e-9), np.ones((2, 3), dtype=np.int64), np.zeros((2, 3), dtype=bool)
    found = allocate(case, share)
    assert not found.rate.any()
    assert not found.power_w.any()
