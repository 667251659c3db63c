"""Downlink NOMA: Eqs. (1) to (3), and what happens to picks that break Eq. (2)."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from env.config import EnvConfig, NoiseConfig, PowerConfig
from env.downlink import access
from env.downlink.allocation import Downlink

NOISE_W = 1e-13  # -100 dBm/Hz over 1 Hz
MARGIN_W = 1e-12  # ten times the noise

gains = st.floats(1e-13, 1e-3)
powers = st.floats(0.0, 1.0)


@st.composite
def slots(draw, most=5, levels=6):
    """Gains, picks and who is served, for one slot."""
    robots = draw(st.integers(1, most))
    return (
        draw(st.lists(gains, min_size=robots, max_size=robots)),
        draw(st.lists(st.integers(1, levels), min_size=robots, max_size=robots)),
        draw(st.lists(st.booleans(), min_size=robots, max_size=robots)),
    )


@st.composite
def ranked(draw):
    """Gains in rank order and powers, for one slot of two robots or more."""
    robots = draw(st.integers(2, 6))
    gain = sorted(draw(st.lists(gains, min_size=robots, max_size=robots)), reverse=True)
    return np.array(gain), np.array(draw(st.lists(powers, min_size=robots, max_size=robots)))


@functools.cache
def downlink(robots, resolve, levels=6, max_dbm=20.0):
    return Downlink(
        EnvConfig(robots=robots, power=PowerConfig(resolve=resolve, levels=levels, max_dbm=max_dbm))
    )


def allocate(case, resolve, **options):
    gain, picks, served = (np.array([values]) for values in case)
    return downlink(gain.shape[1], resolve, **options).allocate(gain, picks, served)


def literal_slot(gain, picks, served, resolve):
    """Powers, rates and failures of one slot, robot by robot, as the paper writes them."""
    order = sorted((k for k in range(len(gain)) if served[k]), key=lambda k: (-gain[k], k))
    sent = {k: 0.1 / 2 ** picks[k] for k in order}
    if sum(sent.values()) > 0.1:
        total = sum(sent.values())
        sent = {k: p * 0.1 / total for k, p in sent.items()}
    failed, rate = [False] * len(gain), [0.0] * len(gain)
    for rank, k in enumerate(order):
        stronger = sum(sent[i] for i in order[:rank])
        if rank:
            failed[k] = (sent[k] - stronger) * gain[order[rank - 1]] < MARGIN_W
    for rank, k in enumerate(order):
        interference = sum(sent[i] for i in order[:rank])
        if resolve == "residual":
            interference += sum(sent[i] for i in order[rank + 1 :] if failed[i])
        sinr = gain[k] * sent[k] / (gain[k] * interference + NOISE_W)
        rate[k] = 0.0 if resolve == "zero" and failed[k] else math.log2(1 + sinr)
    return [sent.get(k, 0.0) for k in range(len(gain))], rate, failed


def test_robots_are_ranked_by_their_channel_strongest_first():
    order = access.decoding_order(np.array([1.0, 4.0, 2.0]), np.array([True, True, True]))
    assert order.tolist() == [1, 2, 0]


def test_equal_channels_are_ranked_by_robot_index_and_idle_robots_come_last():
    gain = np.array([[2.0, 2.0, 9.0, 2.0], [1.0, 2.0, 3.0, 4.0]])
    served = np.array([[True, True, False, True], [False, False, False, False]])
    assert access.decoding_order(gain, served).tolist() == [[0, 1, 3, 2], [0, 1, 2, 3]]


def test_rates_are_those_of_the_received_signal_of_eq_1_after_cancellation():
    """Sends symbols through y = h sum_i sqrt(p_i) s_i + n and measures what is left of them."""
    generator = np.random.default_rng(5)
    gain, power, noise = np.array([4.0, 2.0, 1.0]), np.array([0.5, 1.0, 2.0]), 0.5
    parts = generator.standard_normal((4, 2, 300_000)) / math.sqrt(2)
    symbols = parts[:3, 0] + 1j * parts[:3, 1]
    n = math.sqrt(noise) * (parts[3, 0] + 1j * parts[3, 1])
    rates = access.downlink_rates(gain, power, noise)
    for k in range(3):
        received = math.sqrt(gain[k]) * (np.sqrt(power) @ symbols) + n
        cancelled = math.sqrt(gain[k]) * (np.sqrt(power[k + 1 :]) @ symbols[k + 1 :])
        wanted = math.sqrt(gain[k] * power[k]) * symbols[k]
        rest = received - cancelled - wanted
        sinr = np.mean(np.abs(wanted) ** 2) / np.mean(np.abs(rest) ** 2)
        assert rates[k] == pytest.approx(math.log2(1 + sinr), rel=0.01)


def test_sic_margins_of_eq_2_by_hand():
    gain, power = np.array([4.0, 2.0, 1.0]), np.array([0.1, 0.3, 0.8])
    # (0.3 - 0.1) 4 and (0.8 - 0.1 - 0.3) 2.
    assert access.sic_margins(gain, power) == pytest.approx([0.8, 0.8])


@pytest.mark.parametrize(("margin_w", "failed"), [(0.7, [False, False]), (0.9, [True, True])])
def test_a_signal_fails_where_its_margin_is_too_small(margin_w, failed):
    gain, power = np.array([4.0, 2.0, 1.0]), np.array([0.1, 0.3, 0.8])
    found = access.sic_failures(gain, power, np.ones(3, dtype=bool), margin_w)
    assert found.tolist() == [False, *failed]


def test_a_rank_that_is_not_served_never_fails():
    gain, power = np.array([4.0, 2.0, 1.0]), np.array([0.3, 0.1, 0.0])
    found = access.sic_failures(gain, power, np.array([True, True, False]), 0.01)
    assert found.tolist() == [False, True, False]


def test_rates_of_eq_3_by_hand():
    gain, power = np.array([4.0, 2.0, 1.0]), np.array([0.5, 1.0, 2.0])
    # log2(1 + 2 / 0.5), log2(1 + 2 / (1 + 0.5)), log2(1 + 2 / (1.5 + 0.5)).
    expected = [math.log2(5), math.log2(1 + 4 / 3), 1.0]
    assert access.downlink_rates(gain, power, 0.5) == pytest.approx(expected)


@st.composite
def canonical(draw):
    """Gains in rank order and the canonical powers P/2^K, ..., P/2, for one slot."""
    robots = draw(st.integers(1, 8))
    gain = sorted(draw(st.lists(gains, min_size=robots, max_size=robots)), reverse=True)
    power = draw(st.floats(1e-4, 10.0)) / 2.0 ** np.arange(robots, 0, -1)
    return np.array(gain), power


@given(canonical())
def test_canonical_powers_give_the_closed_form_of_high_snr(case):
    """Without noise, rank k >= 2 has log2(1 + p_k / S_k) with S_k = sum_{j<k} p_j.

    Noise turns S_k into S_k + sigma^2 / g_k, so that the closed form is too high by
    log2(1 + e_k) - log2(1 + e_k S_k / (S_k + p_k)) where e_k = sigma^2 / (g_k S_k) is one over
    the SNR of the interference. That is positive, and at most e_k p_k / (S_k + p_k) / ln 2.
    """
    gain, power = case
    rates = access.downlink_rates(gain, power, NOISE_W)
    stronger = np.cumsum(power)[:-1]
    closed = np.log2(1 + np.append(gain[0] * power[0] / NOISE_W, power[1:] / stronger))
    inverse_snr = NOISE_W / (gain[1:] * stronger)
    bound = inverse_snr * power[1:] / (stronger + power[1:]) / math.log(2)
    assert rates[0] == pytest.approx(closed[0], rel=1e-9, abs=1e-12)
    short = closed[1:] - rates[1:]
    assert (short >= -1e-9).all()
    assert (short <= bound + 1e-9).all()
    assert -1e-9 <= closed.sum() - rates.sum() <= bound.sum() + 1e-9


def test_three_canonical_powers_at_high_snr_by_hand():
    """P/8, P/4 and P/2 without noise: log2(1 + P g_1 / 8 sigma^2) + log2 3 + log2(7 / 3)."""
    rates = access.downlink_rates(np.array([3.0, 2.0, 1.0]), np.array([1.0, 2.0, 4.0]), 1e-9)
    assert rates.sum() == pytest.approx(math.log2(1 + 3e9) + math.log2(7), abs=1e-8)


def test_a_signal_that_stays_interferes_at_every_stronger_robot_by_hand():
    gain, power = np.array([4.0, 2.0, 1.0]), np.array([0.5, 1.0, 2.0])
    rates = access.downlink_rates(gain, power, 0.5, np.array([False, False, True]))
    # log2(1 + 2 / (4 * 2 + 0.5)), log2(1 + 2 / (2 * 2.5 + 0.5)), and robot 3 as before.
    expected = [math.log2(1 + 2 / 8.5), math.log2(1 + 2 / 5.5), 1.0]
    assert rates == pytest.approx(expected)


@given(ranked())
def test_rates_are_never_negative(case):
    gain, power = case
    assert (access.downlink_rates(gain, power, NOISE_W) >= 0).all()
    everything = np.ones(len(gain), dtype=bool)
    assert (access.downlink_rates(gain, power, NOISE_W, everything) >= 0).all()


@given(ranked(), st.floats(0.01, 1.0), st.data())
def test_rates_fall_when_a_stronger_robot_takes_power(case, more_w, data):
    gain, power = case
    rank = data.draw(st.integers(0, len(gain) - 1))
    before = access.downlink_rates(gain, power, NOISE_W)
    power = power.copy()
    power[rank] += more_w
    after = access.downlink_rates(gain, power, NOISE_W)
    assert after[rank] > before[rank]
    assert (after[rank + 1 :] <= before[rank + 1 :]).all()
    assert after[:rank] == pytest.approx(before[:rank], rel=1e-9)


@given(ranked(), st.floats(0.01, 1.0))
def test_rates_fall_when_a_weaker_robot_takes_power_that_cannot_be_cancelled(case, more_w):
    gain, power = case
    power[:-1] += 0.01
    residual = np.zeros(len(gain), dtype=bool)
    residual[-1] = True
    before = access.downlink_rates(gain, power, NOISE_W, residual)
    power[-1] += more_w
    after = access.downlink_rates(gain, power, NOISE_W, residual)
    audible = before[:-1] > 1e-9
    assert (after[:-1] <= before[:-1]).all()
    assert (after[:-1] < before[:-1])[audible & (gain[:-1] > 1e-10)].all()


@given(slots(), st.sampled_from(["residual", "zero"]))
def test_picks_that_stand_give_the_literal_powers_and_rates(case, resolve):
    found = allocate(case, resolve)
    power_w, rate, failed = literal_slot(*case, resolve)  # type: ignore[call-arg]
    assert found.power_w[0] == pytest.approx(power_w, rel=1e-9)
    assert found.rate[0] == pytest.approx(rate, rel=1e-9, abs=1e-12)
    assert found.sic_failed[0].tolist() == failed
    assert not found.projected.any()
    assert not found.margin_dropped.any()


def test_two_equal_picks_by_hand():
    """Both robots pick P_max / 2: the weaker one's signal cannot be decoded at the stronger."""
    case = ([4e-10, 1e-10], [1, 1], [True, True])
    loud, quiet = 4e-10 * 0.05, 1e-10 * 0.05
    weaker = math.log2(1 + quiet / (quiet + NOISE_W))
    kept = allocate(case, "residual")
    assert kept.sic_failed.tolist() == [[False, True]]
    assert kept.rate[0] == pytest.approx([math.log2(1 + loud / (loud + NOISE_W)), weaker])
    assert allocate(case, "zero").rate[0] == pytest.approx([math.log2(1 + loud / NOISE_W), 0.0])
    changed = allocate(case, "project")
    assert changed.power_w[0] == pytest.approx([0.025, 0.05])
    assert changed.projected.tolist() == [True]


def test_picks_over_the_budget_are_scaled_down():
    found = allocate(([3e-9, 2e-9, 1e-9], [1, 1, 2], [True] * 3), "residual")
    assert found.power_w[0] == pytest.approx([0.04, 0.04, 0.02])


@given(slots(most=6))
def test_projected_powers_keep_every_constraint_of_the_paper(case):
    """Eqs. (5c), (5d) and (5g), and p_1 < P_max / 2^(K-1)."""
    found = allocate(case, "project")
    served = np.array(case[2])
    power = found.power_w[0]
    assert (power[served] > 0).all()
    assert (power[~served] == 0).all()
    assert power.sum() < 0.1
    ranks = [k for k in found.order[0] if served[k]]
    assert sorted(power[ranks]) == list(power[ranks])
    assert len({*power[ranks]}) == len(ranks)
    if ranks:
        assert power[ranks[0]] < 0.1 / 2 ** (len(ranks) - 1)
    gain = np.array(case[0])[ranks]
    assert (np.diff(gain) <= 0).all()
    if not found.margin_dropped[0]:
        assert not found.sic_failed.any()
        margins = (power[ranks][1:] - np.cumsum(power[ranks])[:-1]) * gain[:-1]
        assert (margins >= MARGIN_W * (1 - 1e-9)).all()


@given(slots(most=6))
def test_feasible_picks_are_sent_as_they_are_and_called_unchanged(case):
    first = allocate(case, "project")
    levels = np.where(case[2], np.round(np.log2(0.1 / np.maximum(first.power_w[0], 1e-9))), 1)
    again = allocate((case[0], levels.astype(int).tolist(), case[2]), "project")
    assert (again.power_w == first.power_w).all()
    assert not again.projected.any()


@given(slots(), st.sampled_from(["project", "residual", "zero"]), st.randoms())
def test_a_robots_rate_does_not_depend_on_its_index(case, resolve, random):
    gain = [g * (1 + 1e-6 * k) for k, g in enumerate(case[0])]
    if len({*gain}) < len(gain):
        return
    shuffled = list(range(len(gain)))
    random.shuffle(shuffled)
    found = allocate((gain, *case[1:]), resolve)
    moved = allocate([[values[k] for k in shuffled] for values in (gain, *case[1:])], resolve)
    assert (moved.rate[0] == found.rate[0, shuffled]).all()
    assert (moved.power_w[0] == found.power_w[0, shuffled]).all()


@pytest.mark.parametrize("resolve", ["project", "residual", "zero"])
def test_nobody_served_means_no_power_and_no_rate(resolve):
    found = allocate(([1e-9] * 3, [1, 2, 3], [False] * 3), resolve)
    assert not found.rate.any()
    assert not found.power_w.any()
    assert not found.sic_failed.any()
    assert not found.projected.any()


def test_a_robot_alone_is_sent_what_it_picks():
    found = allocate(([1e-10], [3], [True]), "project")
    assert found.power_w[0] == pytest.approx([0.0125])
    assert found.rate[0] == pytest.approx([math.log2(1 + 1e-10 * 0.0125 / NOISE_W)])


def test_channels_too_weak_for_the_margin_are_served_without_it_and_counted():
    # At 0 dBm P_max |h|^2 = 1e-15 W, a thousandth of rho_min.
    found = allocate(([2e-12, 1e-12], [2, 2], [True, True]), "project", max_dbm=0.0)
    assert found.margin_dropped.tolist() == [True]
    assert found.sic_failed.tolist() == [[False, True]]
    assert found.power_w[0] == pytest.approx([1.25e-4, 2.5e-4])  # 3 2 and 2 1 are as near


def test_the_noise_is_the_density_times_the_bandwidth():
    found = Downlink(EnvConfig())
    assert found.noise_w == pytest.approx(1e-13)
    assert found.margin_w == pytest.approx(1e-12)
    assert found.max_power_w == pytest.approx(0.1)
    wide = Downlink(EnvConfig(noise=NoiseConfig(bandwidth_hz=1e6)))
    assert wide.noise_w == pytest.approx(1e-7)
