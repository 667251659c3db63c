"""Configuration, replay, exploration and losses."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from agent_helpers import generators, same_bits
from hypothesis import given
from hypothesis import strategies as st

from agent import AgentConfig, DiscountConfig, EpsilonConfig, TargetConfig, epsilon_at
from agent.config import rules
from agent.exploration import GREEDY, NO_ACTION, _explore_in_worlds, explore
from agent.learning.losses import double_dqn_values, dqn_values, huber, td_target
from agent.replay import Replay, RowLayout
from env import validate
from storage.generators import generator_state, restore_generator


def problems(config):
    """What a whole configuration's checks say of the group."""
    return validate.problems(config, (rules,), "agent.")


def test_the_default_configuration_has_no_problems():
    assert problems(AgentConfig()) == []


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"hidden": []}, "agent.hidden"),
        ({"hidden": [64, 0]}, "agent.hidden"),
        ({"hidden": [5000]}, "agent.hidden"),
        ({"learning_rate": 0.0}, "agent.learning_rate"),
        ({"learning_rate": float("nan")}, "agent.learning_rate"),
        ({"learning_rate_end": 2e-4}, "agent.learning_rate_end"),
        ({"learning_rate_end": -1e-5}, "agent.learning_rate_end"),
        ({"learning_rate_updates": 0}, "agent.learning_rate_updates"),
        ({"updates": 0}, "agent.updates"),
        ({"updates": 101}, "agent.updates"),
        ({"huber_delta": -1.0}, "agent.huber_delta"),
        ({"reward_scale": float("inf")}, "agent.reward_scale"),
        ({"batch_size": 0}, "agent.batch_size"),
        ({"batch_size": 300, "replay_size": 200}, "agent.batch_size"),
        ({"learn_from": 300, "replay_size": 200}, "agent.learn_from"),
        ({"learn_from": 0}, "agent.learn_from"),
        ({"discount": DiscountConfig(robot=1.0)}, "agent.discount.robot"),
        ({"discount": DiscountConfig(ap=-0.1)}, "agent.discount.ap"),
        ({"target": TargetConfig(every=0)}, "agent.target.every"),
        ({"target": TargetConfig(tau=0.0)}, "agent.target.tau"),
        ({"epsilon": EpsilonConfig(start=1.5)}, "agent.epsilon.start"),
        ({"epsilon": EpsilonConfig(start=0.1, end=0.5)}, "agent.epsilon.end"),
        ({"epsilon": EpsilonConfig(ticks=0)}, "agent.epsilon.ticks"),
    ],
)
def test_a_bad_value_is_named_with_what_is_allowed(changes, key):
    (found,) = problems(AgentConfig(**changes))
    assert found[0] == key
    assert found[2]


def test_an_impossible_replay_size_is_named():
    assert problems(AgentConfig(replay_size=0))[0][0] == "agent.replay_size"


@given(st.integers(1, 40), st.integers(0, 200))
def test_a_replay_holds_the_newest_transitions(capacity, added):
    replay = Replay(capacity, 1)
    for number in range(added):
        replay.add(np.array([number], np.float32))
    assert len(replay) == min(added, capacity)
    assert sorted(replay.rows()[:, 0]) == list(range(max(0, added - capacity), added))
    copy = Replay(capacity, 1)
    copy.restore(replay.rows(), added)
    for ring in (replay, copy):
        ring.add(np.array([added], np.float32))
    assert same_bits(copy.rows(), replay.rows())


@given(st.integers(1, 12), st.lists(st.integers(0, 30), min_size=1, max_size=6))
def test_many_transitions_are_stored_as_one_after_the_other(capacity, sizes):
    at_once, singly = Replay(capacity, 1), Replay(capacity, 1)
    for size in sizes:
        rows = np.arange(at_once.added, at_once.added + size, dtype=np.float32)[:, None]
        at_once.extend(rows)
        for row in rows:
            singly.add(row)
        assert (at_once.added, len(at_once)) == (singly.added, len(singly))
        assert same_bits(at_once.rows(), singly.rows())


def test_samples_are_spread_evenly_over_what_is_held():
    replay, drawn = Replay(100, 1), np.empty((10_000, 1), np.float32)
    for number in range(10):
        replay.add(np.array([number], np.float32))
    replay.sample(np.random.default_rng(0), drawn)
    share = np.bincount(drawn[:, 0].astype(int), minlength=10) / 10_000
    np.testing.assert_allclose(share, 0.1, atol=0.02)


def test_rows_of_a_wrong_shape_are_refused():
    with pytest.raises(ValueError, match="cannot take rows"):
        Replay(10, 3).restore(np.zeros((2, 3), np.float32), added=5)


def test_a_row_gives_back_its_transition():
    layout, rng = RowLayout(4), np.random.default_rng(0)
    rows = np.empty((6, layout.width), np.float32)
    fields = (
        rng.normal(size=(6, 4)).astype(np.float32),
        rng.integers(2**24, size=6),
        rng.normal(size=6).astype(np.float32),
        rng.normal(size=(6, 4)).astype(np.float32),
        rng.random(6) < 0.5,
    )
    layout.pack(*fields, out=rows)
    for given_field, read in zip(fields, layout.unpack(rows), strict=True):
        np.testing.assert_array_equal(given_field, read)


def test_epsilon_falls_linearly_and_stays():
    config = EpsilonConfig()
    assert epsilon_at(config, 0) == 1.0
    assert epsilon_at(config, 5_000) == pytest.approx(0.525)
    assert epsilon_at(config, 10_000) == pytest.approx(0.05)
    assert epsilon_at(config, 10**9) == pytest.approx(0.05)


@pytest.mark.parametrize("worlds", [1, 3])
def test_idle_agents_draw_nothing_and_others_draw_alike_in_any_stack(worlds):
    rngs = generators([1, 2, 3])
    active = np.array([True, False, True])[:, None].repeat(worlds, axis=1)
    many = np.array([explore(rngs, 0.5, 6, active) for _ in range(200)])
    alone = generators([3])
    single = np.array([explore(alone, 0.5, 6, active[2:]) for _ in range(200)])
    assert (many[:, 2] == single[:, 0]).all()
    assert (many[:, 1] == NO_ACTION).all()
    assert same_bits(generator_state(rngs[1]), generator_state(generators([2])[0]))


@pytest.mark.parametrize("worlds", [1, 40])
def test_epsilon_is_the_share_of_random_actions(worlds):
    rngs, everywhere = generators([1]), np.ones((1, worlds), dtype=bool)
    picks = np.array([explore(rngs, 0.3, 6, everywhere) for _ in range(4000 // worlds)]).ravel()
    assert np.mean(picks != GREEDY) == pytest.approx(0.3, abs=0.03)
    assert set(picks) == {GREEDY, 0, 1, 2, 3, 4, 5}


def test_the_many_worlds_of_an_agent_draw_as_its_one_world_does():
    active = np.array([[True]])
    one, many = generators([4]), generators([4])
    scalar = [explore(one, 0.5, 6, active)[0, 0] for _ in range(200)]
    drawn = [_explore_in_worlds(many, 0.5, 6, active)[0, 0] for _ in range(200)]
    assert scalar == drawn


def test_a_stream_is_restored_to_its_place():
    rng = np.random.default_rng(5)
    rng.integers(10, dtype=np.int32)  # leaves spare bits behind
    state = generator_state(rng)
    other = np.random.default_rng(6)
    restore_generator(other, state)
    assert same_bits(
        rng.integers(10, size=9, dtype=np.int32), other.integers(10, size=9, dtype=np.int32)
    )
    with pytest.raises(ValueError, match="only PCG64"):
        generator_state(np.random.Generator(np.random.MT19937(0)))


@pytest.mark.parametrize("delta", [0.3, 1.0, 5.0])
def test_huber_and_its_slope_are_those_of_torch(delta):
    error = torch.linspace(-4, 4, 81, requires_grad=True)
    expected = F.huber_loss(error, torch.zeros(81), delta=delta, reduction="none")
    expected.sum().backward()
    loss, grad = huber(error.detach().numpy()[None], delta)
    np.testing.assert_allclose(loss[0], expected.detach(), atol=1e-6)
    np.testing.assert_allclose(grad[0], error.grad, atol=1e-6)


def test_next_values_take_the_best_action_by_target_or_online():
    online = np.array([[[1, 5], [2, 4]]], np.float32)
    target = np.array([[[7, 3], [6, 9]]], np.float32)
    assert dqn_values(target).tolist() == [[7, 9]]
    assert double_dqn_values(online, target).tolist() == [[6, 3]]
    ones = np.ones((1, 2), np.float32)
    aim = td_target(ones, np.array([[0, 1]], np.float32), 10 * ones, 0.5)
    assert aim.tolist() == [[6, 1]]
