"""One network with a head for each part of a decision, against plain torch and by hand."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from agent_helpers import fleet, generators, same_bits, small_config

from agent import BranchingDQN, Heads, NetworkShape, TargetConfig
from agent.agents.branching import BranchingLearner
from agent.learning.heads import HeadRows

SIZES = (4, 7, 7)
OWN = Heads(SIZES, (0.0, 0.8, 0.8))
SHARED = Heads(SIZES, (0.8, 0.8, 0.8), shared=True)
INPUTS = 5


def shape_of(heads, config):
    return NetworkShape(INPUTS, tuple(config.hidden), heads.actions)


def first_weights(shape, seed=3):
    return np.stack([shape.initial_weights(np.random.default_rng(seed + i)) for i in (0, 1)])


def agent_of(heads, config, seed=1):
    shape = shape_of(heads, config)
    agent = BranchingDQN(shape, heads, config, generators([seed])[0])
    agent.load(first_weights(shape))
    return agent


def transition(rng, heads):
    """A random transition; heads past the first may be idle, and idle ones stay ended."""
    active = rng.random(len(heads.sizes)) < 0.7
    active[0] = True
    reward = rng.normal(scale=20, size=1 if heads.shared else len(active))
    return (
        rng.normal(size=INPUTS).astype(np.float32),
        [rng.integers(size) for size in heads.sizes],
        np.broadcast_to(reward, active.shape),
        rng.normal(size=INPUTS).astype(np.float32),
        (rng.random(len(active)) < 0.2) | ~active,
        active,
    )


def choose(agent, seen, epsilon, active):
    """What the agent chooses in its one world."""
    return agent.choose(seen[None], epsilon, active[None])[0]


def learn(agent, *transition):
    """Lets the agent learn from a transition of its one world."""
    *arrays, active = transition
    return agent.learn(*(np.asarray(array)[None] for array in arrays), active[None])


def live(agent, ticks, seed=0, skip=0):
    """Plays random transitions; returns actions and losses."""
    rng, actions, losses = np.random.default_rng(seed), [], []
    for tick in range(ticks):
        seen, _, *rest = transition(rng, agent.heads)
        if tick >= skip:
            actions.append(choose(agent, seen, 0.3, rest[-1]))
            losses.append(learn(agent, seen, actions[-1], *rest))
    return np.array(actions), np.array(losses)


class Eager:
    """The same agent's update as one writes it with modules and autograd."""

    def __init__(self, shape, heads, config, weights):
        """Starts from online and target weights."""
        self.heads, self.config = heads, config
        self.q, self.target = (self.parameters(shape, row) for row in weights)
        self.optimiser = torch.optim.Adam(sum(self.q, ()), lr=config.learning_rate)

    @staticmethod
    def parameters(shape, row):
        """The layers' weights and biases as leaves."""
        views = shape.views(torch.from_numpy(row.copy())[None])
        return [(w[0].clone().requires_grad_(), b[0].clone().requires_grad_()) for w, b in views]

    @staticmethod
    def values(layers, seen):
        """Values of all heads, shape (B, actions)."""
        for weight, bias in layers[:-1]:
            seen = torch.relu(seen @ weight + bias)
        return seen @ layers[-1][0] + layers[-1][1]

    def update(self, seen, actions, rewards, next_observation, terminal, active):
        """One gradient step; returns the loss."""
        heads = self.heads
        with torch.no_grad():
            after = self.values(self.target, next_observation).split(heads.sizes, dim=1)
            by = self.values(self.q, next_observation).split(heads.sizes, dim=1)
            if not self.config.double:
                by = after
            value = [a.gather(1, b.argmax(1, keepdim=True))[:, 0] for a, b in zip(after, by)]  # noqa: B905
        going_on = active * (1 - terminal)
        loss = torch.zeros(())
        for head, q in enumerate(self.values(self.q, seen).split(heads.sizes, dim=1)):
            if heads.shared:
                still = torch.stack([going_on[:, d] * v for d, v in enumerate(value)]).sum(0)
                bootstrap = still / going_on.sum(1).clamp(min=1)
            else:
                bootstrap = (1 - terminal[:, head]) * value[head]
            aim = rewards[:, head] + heads.discounts[head] * bootstrap
            chosen = q.gather(1, actions[:, head, None])[:, 0]
            each = F.huber_loss(chosen, aim, delta=self.config.huber_delta, reduction="none")
            loss = loss + (each * active[:, head]).mean() / len(heads.sizes)
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()
        return loss.item()


@pytest.mark.parametrize("heads", [OWN, SHARED], ids=["own", "shared"])
@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("widths", [[13, 27], [64, 64]])
def test_an_update_agrees_with_eager_torch(heads, double, widths):
    config = small_config(double=double, hidden=widths)
    shape, layout = shape_of(heads, config), HeadRows(INPUTS, len(SIZES))
    learner = BranchingLearner(shape, heads, config, layout)
    learner.weights[0] = first_weights(shape)
    eager, rng = Eager(shape, heads, config, learner.weights[0]), np.random.default_rng(0)
    for update in range(60):
        for row in learner.batch[0]:
            seen, actions, rewards, *rest = transition(rng, heads)
            layout.pack(seen, actions, np.multiply(rewards, 0.1), *rest, out=row)
        rows = torch.from_numpy(learner.batch[0].copy())
        fields = (
            rows[:, :INPUTS],
            rows[:, layout.actions].long(),
            rows[:, layout.rewards],
            rows[:, INPUTS : 2 * INPUTS],
            rows[:, layout.terminal],
            rows[:, layout.active],
        )
        np.testing.assert_allclose(learner.update([True]), eager.update(*fields), rtol=1e-4)
        if update % 20 == 19:
            learner.copy_to_target(0)
            eager.target = [(w.detach().clone(), b.detach().clone()) for w, b in eager.q]
    parts = [torch.cat([w.flatten(), b]).detach() for w, b in eager.q]
    np.testing.assert_allclose(learner.weights[0, 0], torch.cat(parts), rtol=0, atol=3e-6)


def test_own_targets_by_hand():
    """Head 0 has discount 0, head 1 goes on, head 2 has ended."""
    heads = Heads((2, 2, 2), (0.0, 0.5, 0.5))
    target_q = np.array([[9.0], [8.0], [4.0], [6.0], [3.0], [2.0]], np.float32)
    values = heads.values(target_q)
    assert values[:, 0].tolist() == [9.0, 6.0, 3.0]
    rewards, terminal = np.float32([[1], [2], [3]]), np.float32([[0], [0], [1]])
    found = heads.targets(rewards, terminal, 1 - terminal, values)
    assert found[:, 0].tolist() == [1.0, 5.0, 3.0]


def test_shared_targets_by_hand():
    """The mean of the two heads that go on, (9 + 6) / 2, for all; nothing where none does."""
    heads = Heads((2, 2, 2), (0.5, 0.5, 0.5), shared=True)
    values = np.float32([[9, 9], [6, 6], [3, 3]])
    rewards, terminal = np.float32([[7, 7]] * 3), np.float32([[0, 1], [0, 1], [1, 1]])
    found = heads.targets(rewards, terminal, 1 - terminal, values)
    assert found[:, 0].tolist() == [10.75, 10.75, 10.75]
    assert found[:, 1].tolist() == [7.0, 7.0, 7.0]


def test_double_values_take_the_online_networks_choice():
    heads = Heads((2, 2), (0.5, 0.5))
    target_q = np.float32([[1], [5], [7], [2]])
    online_q = np.float32([[9], [0], [0], [9]])
    assert heads.values(target_q)[:, 0].tolist() == [5.0, 7.0]
    assert heads.values(target_q, online_q)[:, 0].tolist() == [1.0, 2.0]


def test_a_single_head_is_a_dqn():
    config = small_config()
    heads = Heads((7,), (0.8,))
    agent, plain = agent_of(heads, config), fleet(shape_of(heads, config), config, [1])
    plain.load(agent.weights()[0])
    rng, on = np.random.default_rng(0), np.ones(1, bool)
    for _ in range(100):
        seen, _, reward, next_observation, terminal, _ = transition(rng, heads)
        action = choose(agent, seen, 0.3, on)
        assert action == plain.act(seen[None], 0.3, on)
        learn(agent, seen, action, reward, next_observation, [terminal[0]], on)
        plain.learn(seen[None], action, reward, next_observation[None], [terminal[0]], on)
    np.testing.assert_allclose(agent.weights(), plain.weights(), rtol=0, atol=1e-6)


def test_an_idle_head_chooses_nothing_and_its_last_layer_learns_nothing():
    config = small_config()
    agent, rng = agent_of(OWN, config), np.random.default_rng(0)
    before = agent.shape.views(agent.online.copy())[-1]
    active = np.array([True, True, False])
    for _ in range(40):
        seen, _, rewards, next_observation, _, _ = transition(rng, OWN)
        chosen = choose(agent, seen, 0.3, active)
        assert chosen[2] == -1
        learn(agent, seen, chosen, rewards, next_observation, [False, False, True], active)
    after = agent.shape.views(agent.online)[-1]
    for part, learns in ((slice(0, 11), True), (slice(11, 18), False)):
        assert (before[0][..., part] != after[0][..., part]).any() == learns
        assert (before[1][..., part] != after[1][..., part]).any() == learns


def test_each_head_explores_by_itself():
    config, on = small_config(), np.ones(3, bool)
    agent = agent_of(OWN, config)
    seen = np.ones(INPUTS, np.float32)
    greedy = choose(agent, seen, 0.0, on)
    chosen = np.array([choose(agent, seen, 0.5, on) for _ in range(2000)])
    other = chosen != greedy
    expected = 0.5 * (1 - 1 / np.array(SIZES))
    np.testing.assert_allclose(other.mean(axis=0), expected, atol=0.04)
    np.testing.assert_allclose((other[:, 1] & other[:, 2]).mean(), expected[1] ** 2, atol=0.04)
    assert (chosen.max(axis=0) == np.array(SIZES) - 1).all()


def test_a_restored_agent_goes_on_to_the_same_bits():
    config = small_config(target=TargetConfig(every=30))
    whole, first = agent_of(SHARED, config), agent_of(SHARED, config)
    live(whole, 90)
    live(first, 40)
    other = agent_of(SHARED, config, seed=9)
    other.restore_agent(0, first.agent_state(0))
    live(other, 90, skip=40)
    for name, array in whole.agent_state(0).items():
        assert same_bits(array, other.agent_state(0)[name]), name


def test_learning_starts_at_learn_from_transitions():
    _, losses = live(agent_of(OWN, small_config(learn_from=20)), 25)
    assert np.isnan(losses[:19]).all()
    assert np.isfinite(losses[19:]).all()


@pytest.mark.parametrize("heads", [OWN, SHARED], ids=["own", "shared"])
def test_every_head_learns_its_part_of_a_decision(heads):
    """In state s the right part for head d is (s + d) mod its size; each right one pays 1."""
    config = small_config(
        hidden=[32], learning_rate=3e-3, reward_scale=1.0, replay_size=4000, batch_size=32
    )
    agent, on, rng = agent_of(heads, config), np.ones(3, bool), np.random.default_rng(0)
    sight = np.eye(INPUTS, dtype=np.float32)
    right = [[(state + d) % size for d, size in enumerate(SIZES)] for state in range(INPUTS)]
    for tick in range(3000):
        state = rng.integers(INPUTS)
        chosen = choose(agent, sight[state], max(0.3, 1 - tick / 1500), on)
        paid = (chosen == right[state]).astype(float)
        reward = np.full(3, paid.sum()) if heads.shared else paid
        learn(agent, sight[state], chosen, reward, sight[state], on, on)
    found = [choose(agent, seen, 0.0, on).tolist() for seen in sight]
    assert found == right
