"""The stacked learner against the reference, and the rules of learning."""

import random

import numpy as np
import pytest
import torch
from agent_helpers import Experience, fleet, generators, live, same_bits, shape_of, small_config
from threadpoolctl import threadpool_info, threadpool_limits  # type: ignore[import-untyped]

from agent import DQN, AgentConfig, NetworkShape, TargetConfig, single_threaded
from agent.learning.learner import Learner, contiguous_runs, learning_rate_at
from agent.reference import ReferenceDQN
from agent.replay import RowLayout


def row_of(network):
    """A network of the reference in the learner's layout."""
    parts = []
    for layer in network:
        if isinstance(layer, torch.nn.Linear):
            parts += [layer.weight.detach().T.flatten(), layer.bias.detach()]
    return torch.cat(parts).numpy()


@pytest.mark.parametrize(
    ("changes", "discount", "mu"),
    [
        ({}, 0.8, 0.0),
        ({"hidden": [64, 64], "batch_size": 128, "replay_size": 200}, 0.8, 0.0),
        ({"hidden": [128, 128], "batch_size": 128, "replay_size": 200}, 0.8, 0.0),
        ({"double": True}, 0.8, 0.0),
        ({"huber_delta": 0.2}, 0.0, 0.0),
        ({}, 0.8, 0.05),
        ({"learning_rate_end": 1e-4, "learning_rate_updates": 50}, 0.8, 0.0),
    ],
    ids=["plain", "2x64", "2x128", "double", "no discount", "FedProx", "falling rate"],
)
def test_the_learner_agrees_with_the_reference(changes, discount, mu):
    config = small_config(**changes)
    shape = shape_of(config)
    layout, rng = RowLayout(shape.inputs), np.random.default_rng(0)
    learner = Learner(shape, config, discount, agents=2, proximal_mu=mu)
    eager = []
    for agent in range(2):
        row = shape.initial_weights(rng)
        learner.weights[agent], learner.proximal_reference[agent] = row, row
        eager.append(ReferenceDQN(shape, config, discount, rng, row, mu))
    size = config.batch_size
    for update in range(80):
        expected = []
        for agent, plain in enumerate(eager):
            layout.pack(
                rng.normal(size=(size, shape.inputs)),
                rng.integers(shape.actions, size=size),
                rng.normal(size=size),
                rng.normal(size=(size, shape.inputs)),
                rng.random(size) < 0.1,
                learner.batch[agent],
            )
            fields = layout.unpack(learner.batch[agent])
            plain.optimizer.param_groups[0]["lr"] = learning_rate_at(config, update)
            expected.append(plain.update(*(torch.from_numpy(x.copy()) for x in fields)))
        np.testing.assert_allclose(learner.update([True, True]), expected, rtol=1e-4)
        if update % 25 == 24:
            for agent, plain in enumerate(eager):
                plain.copy_to_target()
                learner.copy_to_target(agent)
    for agent, plain in enumerate(eager):
        np.testing.assert_allclose(
            learner.weights[agent, 0], row_of(plain.online), rtol=0, atol=3e-6
        )


def test_a_terminal_transition_does_not_bootstrap():
    config = small_config(batch_size=8, learn_from=1)
    shape = shape_of(config)
    losses = {}
    for discount in (0.0, 0.9):
        for terminal in (True, False):
            agent = fleet(shape, config, [4], discount)
            seen = np.ones((1, 5), np.float32)
            args = (seen, [2], [3.0], -seen, [terminal], np.array([True]))
            losses[discount, terminal] = float(agent.learn(*args)[0])
    assert losses[0.9, True] == pytest.approx(losses[0.0, True], rel=1e-6)
    assert losses[0.9, False] != pytest.approx(losses[0.9, True], rel=1e-3)
    assert losses[0.0, False] == losses[0.0, True]


def test_learning_starts_at_learn_from_transitions():
    config = small_config(learn_from=20)
    experience = Experience(shape_of(config), 1, 25, idle=0)
    _, losses = live(fleet(shape_of(config), config, [1]), experience, [0])
    assert np.isnan(losses[:19, 0]).all()
    assert np.isfinite(losses[19:, 0]).all()


def test_the_target_is_copied_after_every_so_many_own_transitions():
    config = small_config(target=TargetConfig(every=30))
    experience = Experience(shape_of(config), 1, 60, idle=0)
    agent = fleet(shape_of(config), config, [1])
    first = agent.target.copy()
    live(agent, experience, [0], stop=29)
    assert same_bits(agent.target, first)
    live(agent, experience, [0], start=29, stop=30)
    assert same_bits(agent.target, agent.online)
    live(agent, experience, [0], start=30, stop=59)
    assert not same_bits(agent.target, agent.online)


def test_a_soft_target_moves_by_tau_at_every_update():
    config = small_config(target=TargetConfig(every=1, tau=0.25))
    experience = Experience(shape_of(config), 1, 21, idle=0)
    agent = fleet(shape_of(config), config, [1])
    live(agent, experience, [0], stop=20)
    before = agent.target.copy()
    live(agent, experience, [0], start=20)
    np.testing.assert_allclose(agent.target, 0.75 * before + 0.25 * agent.online, atol=1e-7)


def test_fedprox_pulls_towards_the_weights_last_loaded():
    config = small_config()
    shape = shape_of(config)
    experience = Experience(shape, 1, 150, idle=0)
    drift = []
    for mu in (0.0, 10.0):
        agent = fleet(shape, config, [1], mu=mu)
        start = agent.online.copy()
        live(agent, experience, [0])
        drift.append(np.linalg.norm(agent.online - start))
    assert drift[1] < drift[0] / 2


def test_load_takes_weights_for_all_or_for_each_and_leaves_moments_alone():
    config = small_config()
    shape = shape_of(config)
    agents = fleet(shape, config, [1, 2])
    live(agents, Experience(shape, 2, 60), range(2))
    before = agents.state()
    one = np.stack([shape.initial_weights(np.random.default_rng(s)) for s in (5, 6)])
    agents.load(one)
    assert same_bits(agents.weights(), np.stack([one, one]))
    agents.load(np.stack([one, one[::-1]]))
    assert same_bits(agents.target[1], one[0])
    after = agents.state()
    for name in before:
        changed = name.split("/")[1] in ("weights", "anchor")
        assert same_bits(before[name], after[name]) != changed, name
    assert same_bits(after["1/anchor"], one[1])
    with pytest.raises(ValueError, match="weights have shape"):
        agents.load(one[0])


def test_neighbours_are_maximal_runs():
    assert list(contiguous_runs([True, True, False, True], 8)) == [(0, 2), (3, 4)]
    assert list(contiguous_runs([False, False], 8)) == []


def test_long_runs_of_neighbours_are_cut_into_even_parts():
    chosen = [False, *[True] * 9, False, *[True] * 8]
    assert list(contiguous_runs(chosen, 8)) == [(1, 5), (5, 10), (11, 19)]
    assert list(contiguous_runs([True] * 7, 3)) == [(0, 2), (2, 4), (4, 7)]


def test_no_global_random_state_is_touched():
    config = small_config(double=True)
    before = np.random.get_state()[1].tolist(), random.getstate(), torch.get_rng_state().tolist()  # noqa: NPY002
    agents = fleet(shape_of(config), config, [1, 2])
    live(agents, Experience(shape_of(config), 2, 60), range(2))
    agents.restore(agents.state())
    after = np.random.get_state()[1].tolist(), random.getstate(), torch.get_rng_state().tolist()  # noqa: NPY002
    assert before == after


def test_same_seed_same_bits_another_seed_others():
    config = small_config()
    experience = Experience(shape_of(config), 1, 80)
    ends = []
    for seed in (1, 1, 2):
        agent = DQN(shape_of(config), config, 0.8, generators([seed]))
        agent.load(np.stack([shape_of(config).initial_weights(np.random.default_rng(0))] * 2))
        live(agent, experience, [0])
        ends.append(agent.weights())
    assert same_bits(ends[0], ends[1])
    assert not same_bits(ends[0], ends[2])


def test_a_chain_is_learned_to_its_end():
    """Six cells, left or right; only the right end pays, and ends the episode."""
    cells, config = (
        6,
        AgentConfig(
            hidden=[16], learning_rate=3e-3, batch_size=32, learn_from=32, reward_scale=1.0
        ),
    )
    shape, sight = NetworkShape(cells, (16,), 2), np.eye(cells, dtype=np.float32)
    agents = fleet(shape, config, [1, 2, 3], discount=0.9)
    at, on = np.zeros(3, int), np.ones(3, bool)
    for tick in range(1500):
        action = agents.act(sight[at], max(0.1, 1 - tick / 500), on)
        after = np.clip(at + 2 * action - 1, 0, cells - 1)
        goal = after == cells - 1
        agents.learn(sight[at], action, goal.astype(float), sight[after], goal, on)
        at = np.where(goal, 0, after)
    for cell in range(cells - 1):
        assert (agents.act(sight[[cell] * 3], 0.0, on) == 1).all()


def test_single_threaded_holds_when_repeated():
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        with threadpool_limits(2, user_api="blas"):
            single_threaded()
            single_threaded()
            assert torch.get_num_threads() == 1
            products = [pool for pool in threadpool_info() if pool["user_api"] == "blas"]
            assert products
            assert {pool["num_threads"] for pool in products} == {1}
    finally:
        torch.set_num_threads(threads)
