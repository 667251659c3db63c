"""Many copies of the fleet's world as one batched environment of TorchRL's.

``benchmarl_fleet.py`` trains on it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

import env
from env.seeding import Stream, stream

ROBOTS, ACCESS_POINT = "robots", "access_point"
"""The groups of agents: the robots, and the one access point."""


class FleetWorlds(EnvBase):
    """W copies of the fleet's world under TorchRL, stepped at once.

    Robots that have arrived stay, as in ``RISFleetParallelEnv`` with ``absorbing=True``: they are
    paid 0, and of their actions the mask leaves the first.

    Args:
        config: what differs from ``EnvConfig``, nested.
        worlds: W, the batch.
        seed: of the starts.
        device: where tensors are.
    """

    def __init__(
        self, config: Mapping[str, Any], worlds: int, seed: int | None, device: Any = None
    ) -> None:
        super().__init__(device=device, batch_size=torch.Size([worlds]))
        scenario = env.Scenario.drawn(env.checked_config(config), 0)
        self.world = env.World(scenario, stream(seed or 0, Stream.WORLD), worlds)
        self.world.reset()
        counts = {ROBOTS: scenario.actions.count, ACCESS_POINT: self.world.phase_actions}
        agents = {ROBOTS: self.world.robots, ACCESS_POINT: 1}
        seen = as_seen(self.world)
        self.observation_spec = _as_specs(seen)
        self.action_spec = _of_groups(
            agents, worlds, lambda group, shape: {"action": Categorical(counts[group], shape)}
        )
        self.reward_spec = _of_groups(
            agents, worlds, lambda _, shape: {"reward": Unbounded((*shape, 1))}
        )
        flag = Categorical(2, (worlds, 1), dtype=torch.bool)
        self.done_spec = Composite(
            {name: flag.clone() for name in ("done", "terminated", "truncated")}, shape=[worlds]
        )

    def _reset(self, tensordict: TensorDictBase | None, **_: Any) -> TensorDictBase:
        asked = None if tensordict is None else tensordict.get("_reset", None)
        worlds = np.ones(len(self.world.slot), bool) if asked is None else asked[:, 0].numpy()
        self.world.restart(worlds)
        return as_seen(self.world).update(self.done_spec.zero())

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        phase = tensordict[ACCESS_POINT, "action"][:, 0].numpy()
        picks = tensordict[ROBOTS, "action"].numpy()
        brought = self.world.step(phase, *self.world.scenario.actions.decode(picks))
        following = as_seen(self.world)
        paid = {ROBOTS: brought.local_reward, ACCESS_POINT: brought.global_reward[:, None]}
        for group, reward in paid.items():
            following[group, "reward"] = torch.from_numpy(reward).float()[..., None]
        ended, late = (
            torch.from_numpy(x)[:, None] for x in (brought.terminated, brought.truncated)
        )
        return following.update({"terminated": ended, "truncated": late, "done": ended | late})

    def _set_seed(self, seed: int | None) -> None:
        self.world.generator = stream(seed or 0, Stream.WORLD)


def as_seen(world: env.World) -> TensorDict:
    """What the agents of B worlds see, and which of their actions count."""
    local = world.local_observations()
    state = torch.from_numpy(world.global_observation(local))
    worlds, robots, _ = local.shape
    mask = torch.ones(worlds, robots, world.scenario.actions.count, dtype=torch.bool)
    mask[..., 1:] &= torch.from_numpy(world.driving)[..., None]
    everything = torch.ones(worlds, 1, world.phase_actions, dtype=torch.bool)
    of_robots = {"observation": torch.from_numpy(local), "action_mask": mask}
    of_ap = {"observation": state[:, None].clone(), "action_mask": everything}
    groups = {
        ROBOTS: TensorDict(of_robots, [worlds, robots]),
        ACCESS_POINT: TensorDict(of_ap, [worlds, 1]),
    }
    return TensorDict({**groups, "state": state}, [worlds])


def _as_specs(seen: TensorDictBase) -> Composite:
    """Specs of tensors such as these: numbers without bounds, and flags."""
    specs = {}
    for name, value in seen.items():
        if isinstance(value, TensorDictBase):
            specs[name] = _as_specs(value)
        elif value.dtype == torch.bool:
            specs[name] = Categorical(2, value.shape, dtype=torch.bool)
        else:
            specs[name] = Unbounded(value.shape, dtype=value.dtype)
    return Composite(specs, shape=seen.batch_size)


def _of_groups(
    agents: Mapping[str, int], worlds: int, made: Callable[[str, torch.Size], dict[str, Any]]
) -> Composite:
    """Specs of each group, made of its name and the shape (W, agents)."""
    shapes = {group: torch.Size([worlds, count]) for group, count in agents.items()}
    groups = {group: Composite(made(group, shape), shape=shape) for group, shape in shapes.items()}
    return Composite(groups, shape=[worlds])
