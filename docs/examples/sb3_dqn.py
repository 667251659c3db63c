"""Stable-Baselines3's DQN learns the single-robot view: ``python docs/examples/sb3_dqn.py``."""

from __future__ import annotations

import argparse
from typing import NamedTuple

import gymnasium
import numpy as np
from stable_baselines3 import DQN

import env

HELD_OUT = 1_000_000
"""Evaluation episodes have the seeds from here on; training draws its starts from another."""


class Score(NamedTuple):
    """What a greedy policy reaches on held-out starts."""

    success: float
    reward: float


def make() -> gymnasium.Env[np.ndarray, np.int64]:
    """One robot on an empty channel: no other robot takes power."""
    return gymnasium.make(env.SINGLE_ROBOT, others="none")


def evaluate(model: DQN, episodes: int) -> Score:
    """The share of episodes that arrive and the mean sum of rewards, both greedy."""
    view, arrived, total = make(), 0, 0.0
    for seed in range(HELD_OUT, HELD_OUT + episodes):
        seen, _ = view.reset(seed=seed)
        ended = out_of_time = False
        while not (ended or out_of_time):
            action, _ = model.predict(seen, deterministic=True)
            seen, reward, ended, out_of_time, _ = view.step(np.int64(action))
            total += float(reward)
        arrived += ended
    return Score(arrived / episodes, total / episodes)


def learner(seed: int, steps: int) -> DQN:
    """A DQN with exploration down to 5 % over the first half of the steps."""
    return DQN(
        "MlpPolicy",
        gymnasium.wrappers.TransformReward(make(), lambda reward: 0.05 * float(reward)),
        learning_rate=1e-3,
        learning_starts=min(1000, steps // 2),
        batch_size=64,
        train_freq=2,
        gamma=0.8,
        target_update_interval=200,
        exploration_fraction=0.5,
        policy_kwargs={"net_arch": [64, 64]},
        seed=seed,
        device="cpu",
    )


def train(steps: int, seed: int = 0, episodes: int = 100) -> tuple[DQN, Score, Score]:
    """Trains a DQN; returns it with its scores before and after."""
    model = learner(seed, steps)
    before = evaluate(model, episodes)
    model.learn(total_timesteps=steps)
    return model, before, evaluate(model, episodes)


def main() -> None:
    """Trains from the command line and prints what it brought."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=30_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=100, help="of each evaluation")
    options = parser.parse_args()
    _, before, after = train(options.steps, options.seed, options.episodes)
    for name, score in (("before", before), ("after", after)):
        print(f"{name}: success {score.success:.2f}, mean reward {score.reward:.1f}")


if __name__ == "__main__":
    main()
