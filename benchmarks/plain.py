"""A DQN learner as it is commonly written: the rival of the stacked engine.

It follows CleanRL's ``dqn.py`` (Huang et al., JMLR 23, 2022) with the replay of Stable-Baselines3
(Raffin et al., JMLR 22, 2021): a ``Sequential`` network, autograd, ``torch.optim.Adam``, a buffer
with an array for each field. What costs time here and is not needed is left as users write it.
"""

from __future__ import annotations

import random

import numpy as np
import torch
import torch.nn.functional as functional
from numpy.typing import NDArray
from torch import nn

FloatArray = NDArray[np.float32]


class PlainReplay:
    """Transitions in separate arrays of shape (capacity, 1 environment, ...), as in SB3."""

    def __init__(self, capacity: int, inputs: int, generator: np.random.Generator) -> None:
        self._capacity, self._generator = capacity, generator
        self._observations = np.zeros((capacity, 1, inputs), np.float32)
        self._following = np.zeros((capacity, 1, inputs), np.float32)
        self._actions = np.zeros((capacity, 1, 1), np.int64)
        self._rewards = np.zeros((capacity, 1), np.float32)
        self._dones = np.zeros((capacity, 1), np.float32)
        self._timeouts = np.zeros((capacity, 1), np.float32)
        self._position, self._full = 0, False

    def add(
        self,
        observation: FloatArray,
        following: FloatArray,
        action: int,
        reward: float,
        done: bool,
    ) -> None:
        """Stores a transition."""
        at = self._position
        self._observations[at] = np.array(observation)
        self._following[at] = np.array(following)
        self._actions[at] = action
        self._rewards[at] = reward
        self._dones[at] = done
        self._timeouts[at] = False
        self._position += 1
        if self._position == self._capacity:
            self._full, self._position = True, 0

    def sample(self, size: int) -> tuple[torch.Tensor, ...]:
        """Observations, actions, next observations, dones and rewards, drawn uniformly."""
        held = self._capacity if self._full else self._position
        at = self._generator.integers(0, held, size=size)
        one = self._generator.integers(0, 1, size=size)
        dones = self._dones[at, one] * (1 - self._timeouts[at, one])
        fields = (
            self._observations[at, one, :],
            self._actions[at, one, :],
            self._following[at, one, :],
            dones.reshape(-1, 1),
            self._rewards[at, one].reshape(-1, 1),
        )
        return tuple(torch.tensor(field) for field in fields)


class PlainLearner:
    """One agent with networks, optimiser and replay of its own."""

    def __init__(
        self,
        inputs: int,
        actions: int,
        width: int,
        discount: float,
        seed: int,
        *,
        learning_rate: float = 1e-4,
        batch_size: int = 128,
        replay_size: int = 50_000,
        copy_every: int = 100,
    ) -> None:
        self._random = random.Random(seed)
        self._actions, self._discount = actions, discount
        self._batch_size, self._copy_every, self._stored = batch_size, copy_every, 0
        self._replay = PlainReplay(replay_size, inputs, np.random.default_rng(seed))
        self._online = _network(inputs, actions, width)
        self._target = _network(inputs, actions, width)
        self._target.load_state_dict(self._online.state_dict())
        self._optimiser = torch.optim.Adam(self._online.parameters(), lr=learning_rate)

    def act(self, observation: FloatArray, epsilon: float) -> int:
        """Chooses epsilon-greedily."""
        if self._random.random() < epsilon:
            return self._random.randrange(self._actions)
        values = self._online(torch.Tensor(observation[None]))
        return int(torch.argmax(values, dim=1).cpu().numpy()[0])

    def learn(
        self,
        observation: FloatArray,
        action: int,
        reward: float,
        following: FloatArray,
        done: bool,
    ) -> None:
        """Stores a transition and, once a batch is there, takes one gradient step."""
        self._replay.add(observation, following, action, reward, done)
        self._stored += 1
        if self._stored < self._batch_size:
            return
        observations, actions, next_observations, dones, rewards = self._replay.sample(
            self._batch_size
        )
        with torch.no_grad():
            best, _ = self._target(next_observations).max(dim=1)
            wanted = rewards.flatten() + self._discount * best * (1 - dones.flatten())
        values = self._online(observations).gather(1, actions).squeeze()
        loss = functional.mse_loss(wanted, values)
        self._optimiser.zero_grad()
        loss.backward()
        self._optimiser.step()
        if self._stored % self._copy_every == 0:
            self._target.load_state_dict(self._online.state_dict())


def _network(inputs: int, actions: int, width: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(inputs, width),
        nn.ReLU(),
        nn.Linear(width, width),
        nn.ReLU(),
        nn.Linear(width, actions),
    )
