"""What is decided when weights are frozen, for each scheme, in many worlds at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent import NetworkShape, q_values
from conf import Config, ap_network, central_heads, robot_actions, robot_network
from env.oracles import per_slot
from env.seeding import Stream, stream
from env.world import World
from training.controllers.phase_rules import fixed_phase
from training.controllers.service import Service


class PolicyWeights(NamedTuple):
    """Online weights of each robot, (K, P), or of all, (1, P), and of the access point, (P_AP,)."""

    robots: NDArray[np.float32]
    ap: NDArray[np.float32]


class Decision(NamedTuple):
    """Phase settings, shape (B,), and the robots' directions and power levels, shape (B, K)."""

    phase: NDArray[np.int64]
    direction: NDArray[np.int64]
    level: NDArray[np.int64]


class Exploration:
    """Random choices for blocks of worlds, each with an epsilon and random streams of its own.

    Args:
        seed: of the evaluation.
        epsilons: a block's probability of a random action, for each block.
        episodes: worlds in a block.
    """

    def __init__(self, seed: int, epsilons: Sequence[float], episodes: int) -> None:
        self._blocks = [
            (slice(i * episodes, (i + 1) * episodes), epsilon, stream(seed, Stream.EVALUATION, 1))
            for i, epsilon in enumerate(epsilons)
            if epsilon > 0
        ]
        self._episodes = episodes
        self._phases = [stream(seed, Stream.EVALUATION, 3) for _ in epsilons]

    def __call__(self, greedy: NDArray[np.int64], count: int) -> NDArray[np.int64]:
        """Replaces a share of the actions, shape (B, ...), by random ones below ``count``."""
        for worlds, epsilon, generator in self._blocks:
            block = greedy[worlds]
            random = generator.integers(count, size=block.shape)
            greedy[worlds] = np.where(generator.random(block.shape) < epsilon, random, block)
        return greedy

    def phases(self, count: int) -> NDArray[np.int64]:
        """Random phase actions below ``count`` whatever epsilon is, shape (B,)."""
        drawn = [one.integers(count, size=self._episodes) for one in self._phases]
        return np.concatenate(drawn)


Policy = Callable[[World, PolicyWeights, Exploration], Decision]


def frozen_policy(config: Config, world: World) -> Policy:
    """How a run's scheme decides.

    Args:
        config: the run's configuration.
        world: one with the tables of those that will be played in; not changed.
    """
    made: dict[str, type[_Joint] | type[_Heads]] = {"centralized": _Joint, "branching": _Heads}
    if config.scheme.agents != "federated":
        return made[config.scheme.agents](config)
    if config.scheme.phase != "learned":
        return _Ruled(config, world)
    return _Federated(config)


class RobotNetworks:
    """The robots' networks: every one explores by itself."""

    def __init__(self, config: Config) -> None:
        self._shape, self._actions = robot_network(config), robot_actions(config)

    def __call__(
        self, local: NDArray[np.float32], weights: NDArray[np.float32], exploration: Exploration
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Directions and power picks for states (B, K, local_size)."""
        action = exploration(self.best(local, weights), self._shape.actions)
        return self._actions.decode(action)

    def best(self, local: NDArray[np.float32], weights: NDArray[np.float32]) -> NDArray[np.int64]:
        """Greedy actions, shape (B, K)."""
        worlds, count, size = local.shape
        if len(weights) == 1:
            values = q_values(self._shape, weights, local.reshape(1, worlds * count, size))
            return np.asarray(values.argmax(axis=-1).reshape(worlds, count))
        by_robot = np.ascontiguousarray(local.transpose(1, 0, 2))
        return np.asarray(q_values(self._shape, weights, by_robot).argmax(axis=-1).T)


class _Federated:
    """F-DRL: the access point's network, and the robots'."""

    def __init__(self, config: Config) -> None:
        self._ap, self._robots = ap_network(config), RobotNetworks(config)
        self._service = Service(config)

    def __call__(self, world: World, weights: PolicyWeights, exploration: Exploration) -> Decision:
        local = world.local_observations()
        values = _values(self._ap, weights.ap, world.global_observation(local))
        action = exploration(np.asarray(values.argmax(axis=-1)), self._ap.actions)
        direction, picks = self._robots(local, weights.robots, exploration)
        return _decided(self._service, world, action, direction, picks)


class _Ruled:
    """A rule sets the phases: nothing of it is left to chance but what the rule itself draws.

    The robots have their networks, or drive shortest ways with powers by rank or the best ones.
    """

    def __init__(self, config: Config, world: World) -> None:
        self._rule, self._drive = config.scheme.phase, config.scheme.robots
        self._robots, self._service = RobotNetworks(config), Service(config)
        fixed = fixed_phase(world, config.env.map_seed) if self._rule == "fixed" else 0
        self._fixed = np.array(fixed)

    def __call__(self, world: World, weights: PolicyWeights, exploration: Exploration) -> Decision:
        if self._drive == "shortest_best":
            weights_5a = per_slot.objective_weights(world, world.travel_slots)
            phase, level = per_slot.best_phase_and_powers(world, weights_5a)
            return Decision(phase, per_slot.shortest_directions(world), level)
        phase = np.broadcast_to(self._fixed, len(world.cell))
        if self._rule == "random":
            phase = exploration.phases(world.phase_actions)
        if self._drive == "learned":
            local = world.local_observations()
            direction, picks = self._robots(local, weights.robots, exploration)
            return _decided(self._service, world, phase, direction, picks)
        return self._by_rank(world, phase)

    def _by_rank(self, world: World, phase: NDArray[np.int64]) -> Decision:
        """Shortest ways with canonical powers, which follow from the phase."""
        levels, direction = world.config.power.levels, per_slot.shortest_directions(world)
        gains, driving = per_slot.phase_gains(world), world.driving[:, None]
        by_phase = per_slot.canonical_levels(gains, driving, levels)
        if self._rule == "oracle":
            phase = per_slot.best_phase(world, by_phase)
        return Decision(phase, direction, by_phase[np.arange(len(phase)), phase])


class _Joint:
    """A centralized DQN: its one action is random as a whole, or not at all."""

    def __init__(self, config: Config) -> None:
        self._shape, self._service = ap_network(config), Service(config)
        self._robots, self._actions = config.env.robots, robot_actions(config)

    def __call__(self, world: World, weights: PolicyWeights, exploration: Exploration) -> Decision:
        values = _values(self._shape, weights.ap, world.global_observation())
        joint = exploration(np.asarray(values.argmax(axis=-1)), self._shape.actions)
        action, robots = self._actions.joint_decode(joint, self._robots)
        return _decided(self._service, world, action, *self._actions.decode(robots))


class _Heads:
    """One network with several heads: each explores by itself, as agents of their own do."""

    def __init__(self, config: Config) -> None:
        self._shape, self._heads = ap_network(config), central_heads(config)
        self._actions, self._service = robot_actions(config), Service(config)

    def __call__(self, world: World, weights: PolicyWeights, exploration: Exploration) -> Decision:
        values = _values(self._shape, weights.ap, world.global_observation())
        best, (own, each) = self._heads.best(values), self._heads.sizes[:2]
        action = exploration(best[:, 0].copy(), own)
        robots = exploration(best[:, 1:].copy(), each)
        return _decided(self._service, world, action, *self._actions.decode(robots))


def _decided(
    service: Service,
    world: World,
    action: NDArray[np.int64],
    direction: NDArray[np.int64],
    picks: NDArray[np.int64],
) -> Decision:
    """What comes of the access point's actions, (B,), and the robots' directions and picks."""
    phase, level = service(world, action, picks)
    return Decision(phase, direction, level)


def _values(
    shape: NetworkShape, weights: NDArray[np.float32], state: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Values of one network, (B, actions), on states (B, global_size)."""
    values: NDArray[np.float32] = q_values(shape, weights[None], state[None])[0]
    return values
