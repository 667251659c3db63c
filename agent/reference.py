"""One DQN agent as one writes it in PyTorch: read this first, then the engine that outruns it.

``agent.DQN`` does the same for n agents at once, with gradients by hand: tests hold it against
this class (tests/agent/test_agent_learner.py), ``make bench`` measures what that is worth.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from agent.config import AgentConfig
from agent.networks.mlp import FloatArray, NetworkShape


class ReferenceDQN:
    """Mnih et al., "Human-level control through deep reinforcement learning", Nature 2015.

    Args:
        shape: the network's sizes.
        config: how the agent learns.
        discount: gamma, at least 0 and below 1.
        generator: the agent's own; draws exploration and batches.
        weights: both networks' first row, shape (P,).
        proximal_mu: FedProx's mu.
    """

    def __init__(
        self,
        shape: NetworkShape,
        config: AgentConfig,
        discount: float,
        generator: np.random.Generator,
        weights: FloatArray,
        proximal_mu: float = 0.0,
    ) -> None:
        self.shape, self.config, self.discount, self.mu = shape, config, discount, proximal_mu
        self.generator, self.stored = generator, 0
        self.online, self.target = _network(shape, weights), _network(shape, weights)
        self.proximal_reference = [p.detach().clone() for p in self.online.parameters()]  # w_global
        self.optimizer = torch.optim.Adam(self.online.parameters(), lr=config.learning_rate)
        rows, s = config.replay_size, (config.replay_size, shape.inputs)
        fields = ((s, "f4"), (rows, "i8"), (rows, "f4"), (s, "f4"), (rows, "f4"))
        self.replay = [np.zeros(size, kind) for size, kind in fields]  # D of (s, a, r, s', end)

    def act(self, observation: FloatArray, epsilon: float) -> int:
        """Chooses epsilon-greedily for s, shape (inputs,)."""
        if self.generator.random() < epsilon:
            return int(self.generator.integers(self.shape.actions))
        return int(self.online(torch.from_numpy(observation)).argmax())  # argmax_a Q(s, a)

    def learn(
        self, seen: FloatArray, action: int, reward: float, next_seen: FloatArray, terminal: bool
    ) -> float | None:
        """Stores (s, a, r, s', end); returns the loss once there is enough to learn from."""
        row = (seen, action, reward * self.config.reward_scale, next_seen, terminal)
        for array, value in zip(self.replay, row, strict=True):
            array[self.stored % self.config.replay_size] = value
        self.stored += 1
        held, loss = min(self.stored, self.config.replay_size), None
        if held >= self.config.learn_from:
            drawn = self.generator.integers(held, size=self.config.batch_size)  # D_0
            loss = self.update(*(torch.from_numpy(array[drawn]) for array in self.replay))
        if self.stored % self.config.target.every == 0:
            self.copy_to_target()  # every N_Q of its own transitions
        return loss

    def update(
        self, seen: Tensor, action: Tensor, reward: Tensor, next_seen: Tensor, terminal: Tensor
    ) -> float:
        """One gradient step on a batch; returns the loss."""
        with torch.no_grad():
            next_q = self.target(next_seen)  # Q^-(s', .)
            by = self.online(next_seen) if self.config.double else next_q  # van Hasselt, Eq. (4)
            best = next_q.gather(1, by.argmax(1, keepdim=True))[:, 0]  # Q^-(s', a*)
            y = reward + self.discount * (1 - terminal.float()) * best  # r + gamma Q^-(s', a*)
        q = self.online(seen).gather(1, action[:, None])[:, 0]  # Q(s, a)
        total = loss = nn.functional.huber_loss(q, y, delta=self.config.huber_delta)  # L(w)
        if self.mu:  # FedProx: + (mu/2) ||w - w_global||^2
            pairs = zip(self.online.parameters(), self.proximal_reference, strict=True)
            total = loss + self.mu / 2 * sum(((p - g) ** 2).sum() for p, g in pairs)
        self.optimizer.zero_grad()
        total.backward()  # type: ignore[no-untyped-call]  # torch declares no types for it
        self.optimizer.step()
        return loss.item()

    def copy_to_target(self) -> None:
        """w^- = w."""
        self.target.load_state_dict(self.online.state_dict())


def _network(shape: NetworkShape, weights: FloatArray) -> nn.Sequential:
    layers: list[nn.Module] = []
    for weight, bias in shape.views(torch.from_numpy(weights.copy())[None]):
        linear = nn.Linear(*weight.shape[1:])
        linear.weight.data, linear.bias.data = weight[0].T.contiguous(), bias[0].clone()
        layers += [linear, nn.ReLU()]
    return nn.Sequential(*layers[:-1])
