"""TorchRL learns the whole fleet, PettingZoo's view: ``python docs/examples/torchrl_fleet.py``.

Robots share one Q-network and the access point has another. Robots that have arrived stay in
TorchRL's tensors under a mask, and what the mask leaves out is not learned from.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictSequential
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs.libs.pettingzoo import PettingZooWrapper
from torchrl.modules import MLP, EGreedyModule, QValueActor
from torchrl.objectives import DQNLoss, SoftUpdate

import env
from env.apis.fleet_infos import AP

HELD_OUT = 1_000_000
"""Evaluation episodes have the seeds from here on."""
BATCH, GAMMA, REWARD_SCALE = 64, 0.95, 0.05


class Score(NamedTuple):
    """What greedy policies reach: share of robots that arrive, mean reward of a robot's episode."""

    success: float
    reward: float


class Learner:
    """A DQN for one group of agents that share its network."""

    def __init__(self, view: PettingZooWrapper, group: str, steps: int) -> None:
        spec = view.full_action_spec[group, "action"]
        inputs = view.observation_spec[group, "observation"].shape[-1]
        network = MLP(in_features=inputs, out_features=int(spec.space.n), num_cells=[64, 64])
        self.group = group
        self.actor = QValueActor(network, in_keys=["observation"], action_space="categorical")
        self.explore = EGreedyModule(
            spec, eps_init=1.0, eps_end=0.05, annealing_num_steps=max(1, steps // 2)
        )
        self.policy = TensorDictSequential(self.actor, self.explore)
        self.loss = DQNLoss(self.actor, action_space="categorical", delay_value=True)
        self.loss.make_value_estimator(gamma=GAMMA)
        self.follow = SoftUpdate(self.loss, tau=0.005)
        self.optimiser = torch.optim.Adam(self.loss.parameters(), lr=1e-3)
        self.replay = TensorDictReplayBuffer(storage=LazyTensorStorage(50_000), batch_size=BATCH)

    @torch.no_grad()
    def act(self, slot: TensorDictBase) -> None:
        """Writes the group's actions, some of them random, and explores a little less."""
        slot[self.group, "action"] = self.policy(slot[self.group].select("observation"))["action"]
        self.explore.step()

    def remember(self, slot: TensorDictBase) -> None:
        """Keeps the slot of those agents that were there in it."""
        before, after = slot[self.group], slot["next", self.group]
        follows = after.select("observation", "done", "terminated")
        follows["reward"] = REWARD_SCALE * after["reward"]
        kept = before.select("observation", "action").set("next", follows)
        self.replay.extend(kept[before["mask"]].clone())

    def learn(self) -> None:
        """One step down the loss of a batch."""
        if len(self.replay) >= BATCH:
            self.optimiser.zero_grad()
            self.loss(self.replay.sample())["loss"].backward()
            self.optimiser.step()
            self.follow.step()


def evaluate(learners: list[Learner], robots: int, episodes: int) -> Score:
    """Greedy episodes from held-out starts."""
    view = env.RISFleetParallelEnv({"robots": robots})
    actor = {name: learners[name == AP].actor for name in view.possible_agents}
    arrived, total = 0, 0.0
    for seed in range(HELD_OUT, HELD_OUT + episodes):
        seen, _ = view.reset(seed=seed)
        while view.agents:
            with torch.no_grad():
                picks = {
                    name: int(
                        actor[name](TensorDict(observation=torch.tensor(seen[name])))["action"]
                    )
                    for name in view.agents
                }
            seen, paid, ended, _, _ = view.step(picks)
            arrived += sum(ended[name] for name in ended if name != AP)
            total += sum(paid[name] for name in paid if name != AP)
    return Score(arrived / (episodes * robots), total / (episodes * robots))


def train(
    steps: int, robots: int = 2, seed: int = 0, episodes: int = 50
) -> tuple[list[Learner], Score, Score]:
    """Trains robots and access point; returns both with the scores before and after."""
    with torch.random.fork_rng():  # TorchRL draws from torch's generator: left as it was found
        torch.manual_seed(seed)
        return _train(steps, robots, seed, episodes)


def _train(steps: int, robots: int, seed: int, episodes: int) -> tuple[list[Learner], Score, Score]:
    fleet = env.RISFleetParallelEnv({"robots": robots})
    groups = {"robots": fleet.possible_agents[:-1], "access_point": [AP]}
    view = PettingZooWrapper(fleet, group_map=groups, use_mask=True, done_on_any=False, seed=seed)
    learners = [Learner(view, group, steps) for group in groups]
    before = evaluate(learners, robots, episodes)
    slot = view.reset()
    for _ in range(steps):
        for learner in learners:
            learner.act(slot)
        slot, following = view.step_and_maybe_reset(slot)
        for learner in learners:
            learner.remember(slot)
            learner.learn()
        slot = following
    return learners, before, evaluate(learners, robots, episodes)


def main() -> None:
    """Trains from the command line and prints what it brought."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--robots", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    _, before, after = train(options.steps, options.robots, options.seed)
    for name, score in (("before", before), ("after", after)):
        print(f"{name}: success {score.success:.2f}, mean reward {score.reward:.1f}")


if __name__ == "__main__":
    main()
