"""The stacked learner against a plain eager DQN, and the rules of learning."""

import random

import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from agent_helpers import Experience, fleet, generators, live, same_bits, shape_of, small_config

from agent import DQN, AgentConfig, NetworkShape, PriorityConfig, TargetConfig, single_threaded
from agent.learner import Learner, neighbours
from agent.replay import RowLayout


class JoinStreams(torch.nn.Module):
    """Q = V + A - mean A, with V as the last of the streams."""

    def forward(self, streams):
        """Action values."""
        advantages = streams[:, :-1]
        return streams[:, -1:] + advantages - advantages.mean(1, keepdim=True)


class AddUp(torch.nn.Module):
    """Q(s, (a, b)) = Q_1(s, a) + Q_2(s, b)."""

    def __init__(self, first, second):
        """Takes the number of choices of both parts."""
        super().__init__()
        self.place = [(a, first + b) for a in range(first) for b in range(second)]

    def forward(self, worth):
        """Action values."""
        return torch.stack([worth[:, a] + worth[:, b] for a, b in self.place], dim=1)


class EagerDQN:
    """A DQN as one writes it in PyTorch: modules, autograd, ``torch.optim.Adam``."""

    def __init__(self, shape, config, discount, row, mu):
        """Starts from the weights in `row`."""
        self.config, self.discount, self.mu, self.updates = config, discount, mu, 0
        self.q, self.target = self.module(shape, row), self.module(shape, row)
        self.anchor = [p.detach().clone() for p in self.q.parameters()]
        self.optimiser = torch.optim.Adam(self.q.parameters(), lr=config.learning_rate)

    @staticmethod
    def module(shape, row):
        """The same network as `row`."""
        layers = []
        for weight, bias in shape.views(torch.from_numpy(row.copy())[None]):
            linear = torch.nn.Linear(*weight.shape[1:])
            linear.weight.data, linear.bias.data = weight[0].T.contiguous(), bias[0].clone()
            layers += [linear, torch.nn.ReLU()]
        if shape.factors:
            return torch.nn.Sequential(*layers[:-1], AddUp(*shape.factors))
        return torch.nn.Sequential(*layers[:-1], *[JoinStreams()] * shape.dueling)

    def update(self, seen, action, reward, following, terminal, weights):
        """One gradient step on samples of these weights; returns the loss."""
        with torch.no_grad():
            values = self.target(following)
            chosen = (self.q(following) if self.config.double else values).argmax(1, keepdim=True)
            bootstrap = values.gather(1, chosen)[:, 0] * (1 - terminal.float())
        q = self.q(seen).gather(1, action[:, None])[:, 0]
        aim = reward + self.discount * bootstrap
        each = F.huber_loss(q, aim, delta=self.config.huber_delta, reduction="none")
        loss = (weights * each).mean()
        pull = sum(
            ((p - a) ** 2).sum() for p, a in zip(self.q.parameters(), self.anchor, strict=True)
        )
        if (end := self.config.learning_rate_end) is not None:
            share = min(self.updates / self.config.learning_rate_updates, 1)
            rate = self.config.learning_rate * (1 - share) + end * share
            self.optimiser.param_groups[0]["lr"] = rate
        self.updates += 1
        self.optimiser.zero_grad()
        (loss + self.mu / 2 * pull).backward()
        self.optimiser.step()
        return loss.item()

    def copy_to_target(self):
        """Makes the target equal to the online network."""
        self.target.load_state_dict(self.q.state_dict())

    def row(self):
        """The online network in the learner's layout."""
        parts = []
        for layer in self.q:
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
        ({"dueling": True}, 0.8, 0.0),
        ({"dueling": True, "double": True}, 0.8, 0.0),
        ({"factored": True}, 0.8, 0.0),
        ({"factored": True, "double": True}, 0.8, 0.0),
        ({"priority": PriorityConfig(alpha=0.5)}, 0.8, 0.0),
        ({"learning_rate_end": 1e-4, "learning_rate_updates": 150}, 0.8, 0.0),
    ],
    ids=[
        "plain",
        "2x64",
        "2x128",
        "double",
        "no discount",
        "FedProx",
        "dueling",
        "double dueling",
        "factored",
        "double factored",
        "weighted",
        "falling rate",
    ],
)
def test_the_learner_agrees_with_eager_torch(changes, discount, mu):
    config = small_config(**changes)
    shape = shape_of(config)
    layout, rng = RowLayout(shape.inputs), np.random.default_rng(0)
    learner = Learner(shape, config, discount, agents=2, proximal_mu=mu)
    eager = []
    for agent in range(2):
        row = shape.initial_weights(rng)
        learner.weights[agent], learner.anchor[agent] = row, row
        eager.append(EagerDQN(shape, config, discount, row, mu))
    size = config.batch_size
    for update in range(200):
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
            weights = np.ones(size, np.float32)
            if learner.weighing is not None:
                weights = learner.weighing.importance[agent]
                weights[:] = rng.random(size)
            expected.append(
                plain.update(
                    *(torch.from_numpy(x.copy()) for x in fields[:3]),
                    *(torch.from_numpy(x.copy()) for x in fields[3:]),
                    torch.from_numpy(weights.copy()),
                )
            )
        np.testing.assert_allclose(learner.update([True, True]), expected, rtol=1e-4)
        if update % 50 == 49:
            for agent, plain in enumerate(eager):
                plain.copy_to_target()
                learner.copy_to_target(agent)
    for agent, plain in enumerate(eager):
        np.testing.assert_allclose(learner.weights[agent, 0], plain.row(), rtol=0, atol=3e-6)


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
    experience = Experience(shape, 1, 300, idle=0)
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
    assert list(neighbours([True, True, False, True], 8)) == [(0, 2), (3, 4)]
    assert list(neighbours([False, False], 8)) == []


def test_long_runs_of_neighbours_are_cut_into_even_parts():
    chosen = [False, *[True] * 9, False, *[True] * 8]
    assert list(neighbours(chosen, 8)) == [(1, 5), (5, 10), (11, 19)]
    assert list(neighbours([True] * 7, 3)) == [(0, 2), (2, 4), (4, 7)]


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


def test_single_threaded_holds_when_repeated(monkeypatch, tmp_path):
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        single_threaded()
        single_threaded()
        assert torch.get_num_threads() == 1
        monkeypatch.setattr("agent.threads._MEMORY_MAP", tmp_path / "none")
        single_threaded()
    finally:
        torch.set_num_threads(threads)
