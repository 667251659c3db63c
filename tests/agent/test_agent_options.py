"""Ways of learning beyond the paper's: n-step returns, priorities, more updates, falling rates."""

from collections import Counter
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from agent_helpers import Experience, fleet, generators, live, same_bits, shape_of, small_config
from hypothesis import given
from hypothesis import strategies as st

from agent import PriorityConfig, TargetConfig, q_values
from agent.learning.learner import learning_rate_at
from agent.networks.dueling import DuelingHead
from agent.replay.n_step import NStepBuilder
from agent.replay.prioritised import LEAST_ERROR, PrioritisedReplay
from agent.replay.uniform import RowLayout

LAYOUT = RowLayout(1)


def row(seen, led_to, reward, arrived=False, action=0):
    """A transition between states that are one number each."""
    out = np.empty((1, LAYOUT.width), np.float32)
    LAYOUT.pack([[seen]], [action], [reward], [[led_to]], [arrived], out)
    return out[0]


def pushed(window, *rows):
    """(state, next state, reward, terminal) of all that left a window, call by call."""
    return [
        [(r[0], r[1], r[LAYOUT.reward], r[LAYOUT.terminal]) for r in window.add(each)]
        for each in rows
    ]


def test_a_return_sums_n_rewards_and_bootstraps_from_the_state_after_them():
    window = NStepBuilder(LAYOUT, 3, 0.5)
    left = pushed(window, row(0, 1, 8), row(1, 2, 4), row(2, 3, 2), row(3, 4, 16))
    # discount^3 counts what follows: half of it is td_target's, 1 - terminal = 0.5^2 the rest
    assert left == [[], [], [(0, 3, 8 + 2 + 0.5, 0.75)], [(1, 4, 4 + 1 + 4, 0.75)]]


def test_an_arrival_ends_all_returns_and_nothing_is_bootstrapped():
    window = NStepBuilder(LAYOUT, 3, 0.5)
    left = pushed(window, row(0, 1, 8), row(1, 2, 4), row(2, 3, 2, arrived=True), row(7, 8, 1))
    assert left == [[], [], [(0, 3, 10.5, 1), (1, 3, 5, 1), (2, 3, 2, 1)], []]


def test_an_episode_cut_off_bootstraps_sooner_from_its_last_state():
    window = NStepBuilder(LAYOUT, 3, 0.5)
    left = pushed(window, row(0, 1, 8), row(1, 2, 4), row(7, 8, 2), row(8, 9, 2, arrived=True))
    assert left[2] == [(0, 2, 10, 0.5), (1, 2, 4, 0)]
    assert left[3] == [(7, 9, 3, 1), (8, 9, 2, 1)]


def test_what_waits_is_restored():
    one, other = NStepBuilder(LAYOUT, 4, 0.5), NStepBuilder(LAYOUT, 4, 0.5)
    pushed(one, row(0, 1, 8), row(1, 2, 4))
    other.restore(one.rows())
    rest = row(2, 3, 2), row(3, 4, 1)
    assert pushed(one, *rest) == pushed(other, *rest)
    assert len(NStepBuilder(LAYOUT, 4, 0.5).rows()) == 0


@given(
    steps=st.integers(1, 6),
    lives=st.lists(st.tuples(st.integers(1, 9), st.booleans()), min_size=1, max_size=6),
    data=st.randoms(use_true_random=False),
)
def test_every_transition_is_stored_once_with_the_return_of_its_own_episode(steps, lives, data):
    window, discount, state = NStepBuilder(LAYOUT, steps, 0.5), 0.5, 0
    expected, left = [], []
    for length, arrives in lives:
        rewards = [data.randrange(-8, 9) for _ in range(length)]
        for slot in range(length):
            until = min(slot + steps, length)
            total = sum(r * discount**i for i, r in enumerate(rewards[slot:until]))
            over = arrives and until == length
            rest = 1.0 if over else 1 - discount ** (until - slot - 1)
            expected.append((state + slot, state + until, total, rest))
            ended = arrives and slot == length - 1
            left += pushed(window, row(state + slot, state + slot + 1, rewards[slot], ended))[0]
        state += length + 10
    assert left == expected[: len(left)]
    assert len(expected) - len(left) == len(window.rows()) < steps


def test_one_step_is_what_no_window_gives():
    shape = shape_of(small_config())
    experience = Experience(shape, 2, 90, chained=True)
    plain, windowed = (fleet(shape, small_config(n_step=n), [1, 2]) for n in (1, 2))
    for agent in range(2):
        windowed._windows[agent] = [NStepBuilder(windowed._layout, 1, 0.8)]
    live(plain, experience, [0, 1])
    live(windowed, experience, [0, 1])
    assert same_bits(plain.weights(), windowed.weights())


def test_without_a_discount_there_is_nothing_further_to_sum():
    shape = shape_of(small_config())
    experience = Experience(shape, 2, 60, chained=True)
    ends = []
    for n_step in (1, 5):
        agents = fleet(shape, small_config(n_step=n_step), [1, 2], discount=0.0)
        live(agents, experience, [0, 1])
        ends.append(agents.weights())
    assert same_bits(*ends)


def test_the_target_is_copied_once_where_several_transitions_are_stored_at_once():
    config = small_config(n_step=4, target=TargetConfig(every=10), learn_from=60)
    shape = shape_of(config)
    agent = fleet(shape, config, [1])
    copies: list[Any] = []
    agent._learner.copy_to_target = copies.append
    on, still = np.array([True]), np.zeros((1, shape.inputs), np.float32)
    for slot in range(1, 12):  # an episode of eleven slots, all in the same state
        agent.learn(still, [0], [1.0], still, [slot == 11], on)
    assert agent._replays[0].added == 11
    assert copies == [0]


def replay(alpha, beta, batch, capacity=10):
    """A prioritised replay of rows of one number, and where weights and errors stand."""
    importance, error = np.zeros((2, batch), np.float32)
    config = PriorityConfig(alpha=alpha, beta=beta)
    return PrioritisedReplay(capacity, 1, config, importance, error), importance, error


def surprised(errors, alpha=1.0, beta=1.0, batch=3):
    """A replay whose transitions 0, 1, ... have been drawn once and found with these errors."""
    ring, importance, error = replay(alpha, beta, batch)
    for number in range(len(errors)):
        ring.add(np.array([number], np.float32))
    ring._drawn = np.arange(batch) % len(errors)
    error[:] = np.resize(errors, batch)
    ring.update_priorities()
    return ring, importance, error


def test_transitions_are_drawn_by_their_errors_and_weigh_the_inverse():
    # Shares (|e| + .001)^1 = 1, 2, 5 of 8; N P = 3/8, 6/8, 15/8; weights over the largest drawn.
    ring, importance, _ = surprised(np.array([1, -2, 5]) - LEAST_ERROR * np.array([1, -1, 1]))
    drawn = np.empty((3, 1), np.float32)
    counts: Counter[float] = Counter()
    rng = np.random.default_rng(0)
    for _ in range(4000):
        ring.sample(rng, drawn)
        numbers = drawn[:, 0].astype(int)
        counts.update(numbers.tolist())
        expected = np.array([8 / 3, 4 / 3, 8 / 15])[numbers]
        np.testing.assert_allclose(importance, expected / expected.max(), rtol=1e-6)
    np.testing.assert_allclose(
        [counts[n] / 12_000 for n in range(3)], [1 / 8, 1 / 4, 5 / 8], atol=0.015
    )


def test_alpha_flattens_chances_and_beta_of_zero_makes_all_weigh_alike():
    ring, importance, _ = surprised(np.array([0.999, 3.999, 8.999]), alpha=0.5, beta=0.0)
    np.testing.assert_allclose(ring.extra_state()["priorities"], [1, 2, 3, 3], rtol=1e-6)
    ring.sample(np.random.default_rng(0), np.empty((3, 1), np.float32))
    assert importance.tolist() == [1, 1, 1]


def test_a_new_transition_is_as_likely_as_the_most_surprising_ever():
    ring, _, error = surprised(np.array([0.999, 3.999, 8.999]))
    ring._drawn = np.arange(3)
    error[:] = 0.999
    ring.update_priorities()
    ring.add(np.array([3], np.float32))
    np.testing.assert_allclose(ring.extra_state()["priorities"], [1, 1, 1, 9, 9], rtol=1e-6)


def test_a_transition_that_overwrites_another_has_a_chance_of_its_own():
    ring, _, _ = replay(1.0, 0.4, batch=2, capacity=2)
    for number in range(2):
        ring.add(np.array([number], np.float32))
    ring._shares[:] = 5.0, 7.0
    ring.add(np.array([2], np.float32))
    assert ring.extra_state()["priorities"].tolist() == [1, 7, 1]


@given(
    errors=st.lists(st.floats(-100, 100, width=32), min_size=1, max_size=8),
    alpha=st.floats(0.1, 1),
    beta=st.floats(0, 1),
)
def test_weights_are_above_zero_and_at_most_one(errors, alpha, beta):
    ring, importance, _ = surprised(errors, alpha, beta, batch=8)
    ring.sample(np.random.default_rng(0), np.empty((8, 1), np.float32))
    assert ((importance > 0) & (importance <= 1)).all()
    assert importance.max() == 1


def test_errors_come_back_from_the_gradient_step():
    config = small_config(priority=PriorityConfig(alpha=1.0, beta=0.0), learn_from=1)
    shape = shape_of(config)
    agent = fleet(shape, config, [4], discount=0.0)
    seen = np.ones((1, 5), np.float32)
    q = q_values(shape, agent.online.copy(), seen[None])[0, 0, 2]
    agent.learn(seen, [2], [30.0], -seen, [False], np.array([True]))
    error = abs(q - np.float32(3.0))
    np.testing.assert_allclose(
        agent.agent_state(0)["priorities"][0], error + LEAST_ERROR, rtol=1e-5
    )


def test_several_updates_follow_each_transition():
    config = small_config(updates=3, learn_from=20)
    experience = Experience(shape_of(config), 1, 25, idle=0)
    agent = fleet(shape_of(config), config, [1])
    live(agent, experience, [0])
    assert agent.agent_state(0)["updates"] == 3 * 6


def test_the_learning_rate_falls_over_an_agents_own_updates():
    config = small_config(learning_rate_end=2e-4, learning_rate_updates=10)
    rates = [learning_rate_at(config, updates) for updates in range(15)]
    assert rates[0] == 1e-3
    assert rates[5] == pytest.approx(6e-4)
    assert rates[10:] == [pytest.approx(2e-4)] * 5
    assert all(later <= earlier for earlier, later in pairwise(rates))
    assert learning_rate_at(small_config(), 10**6) == 1e-3


def test_a_rate_that_has_fallen_to_zero_moves_nothing():
    config = small_config(learning_rate_end=0.0, learning_rate_updates=5)
    experience = Experience(shape_of(config), 1, 60, idle=0)
    agent = fleet(shape_of(config), config, [1])
    live(agent, experience, [0], stop=25)  # six updates
    before = agent.online.copy()
    live(agent, experience, [0], start=25)
    assert same_bits(agent.online, before)


def test_dueling_streams_are_joined_as_a_hand_computed_case():
    streams = np.array([[[1, 2], [3, 0], [5, 4], [10, 20]]], np.float32)  # A of 3 actions, then V
    form = DuelingHead(3)
    joined = form.action_values(streams, axis=1)
    assert joined[0].tolist() == [[10 + 1 - 3, 20 + 2 - 2], [10 + 3 - 3, 18], [12, 22]]
    turned = form.action_values(np.moveaxis(streams, 1, 2), axis=-1)
    assert same_bits(turned, joined.transpose(0, 2, 1))


@given(st.builds(DuelingHead, st.integers(1, 5)), st.integers(1, 4), st.integers(0, 99))
def test_the_way_back_through_a_form_is_the_transposed_map(form, batch, seed):
    rng = np.random.default_rng(seed)
    outputs = rng.normal(size=(2, form.outputs, batch)).astype(np.float32)
    grad = rng.normal(size=(2, form.actions, batch)).astype(np.float32)
    back = np.empty_like(outputs)
    form.backward(grad, back)
    there = (form.action_values(outputs, axis=1) * grad).sum()
    np.testing.assert_allclose(there, (outputs * back).sum(), rtol=1e-3, atol=1e-3)


def test_agents_with_priorities_draw_by_their_own_streams_alone():
    config = small_config(priority=PriorityConfig(alpha=0.6))
    ends = []
    for seed in (1, 1, 2):
        agents = fleet(shape_of(config), config, [1])
        agents._generators[0] = generators([seed])[0]
        live(agents, Experience(shape_of(config), 1, 60), [0])
        ends.append(agents.weights())
    assert same_bits(ends[0], ends[1])
    assert not same_bits(ends[0], ends[2])
