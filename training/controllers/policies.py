"""What is decided when weights are frozen, for each scheme, in many worlds at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent import q_values
from conf import Config, ap_network, central_heads, robot_actions, robot_network
from env.oracles import per_slot
from env.seeding import Stream, stream
from env.world import World
from training.controllers.phase_rules import phase_of
from training.controllers.service import Actions, Service


class PolicyWeights(NamedTuple):
    """Online weights of each robot, (K, P), or of all, (1, P), and of the access point, (P_AP,)."""

    robots: NDArray[np.float32]
    ap: NDArray[np.float32]


class Decision(NamedTuple):
    """Phase settings, shape (B,), and the robots' directions and power levels, shape (B, K)."""

    phase: Actions
    direction: Actions
    level: Actions


class Exploration:
    """Random choices for blocks of worlds, each with an epsilon and random streams of its own.

    Args:
        seed: of the evaluation.
        epsilons: each block's probability of a random action.
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

    def __call__(self, greedy: Actions, count: int) -> Actions:
        """Replaces a share of the actions, shape (B, ...), by random ones below ``count``."""
        for worlds, epsilon, generator in self._blocks:
            greedy[worlds] = explored(greedy[worlds], count, epsilon, generator)
        return greedy

    def phases(self, count: int) -> Actions:
        """Random phase actions below ``count`` whatever epsilon is, shape (B,)."""
        drawn = [one.integers(count, size=self._episodes) for one in self._phases]
        return np.concatenate(drawn)


def explored(best: Actions, count: int, epsilon: float, generator: np.random.Generator) -> Actions:
    """Replaces a share epsilon of actions by random ones below ``count``."""
    random = generator.integers(count, size=best.shape)
    return np.asarray(np.where(generator.random(best.shape) < epsilon, random, best))


Policy = Callable[[World, PolicyWeights, Exploration], Decision]


def frozen_policy(config: Config, world: World) -> Policy:
    """How a run's scheme decides, in worlds with the tables of this one, which is not changed."""
    if config.scheme.agents == "centralized":
        return _Joint(config)
    if config.scheme.agents == "branching":
        return _Heads(config)
    return _Federated(config) if config.scheme.phase == "learned" else _Ruled(config, world)


class RobotNetworks:
    """The robots' networks: every one explores by itself."""

    def __init__(self, config: Config) -> None:
        self._shape, self._actions = robot_network(config), robot_actions(config)

    def __call__(
        self, local: NDArray[np.float32], weights: NDArray[np.float32], exploration: Exploration
    ) -> tuple[Actions, Actions]:
        """Directions and power picks for states (B, K, local_size)."""
        action = exploration(self.best(local, weights), self._shape.actions)
        return self._actions.decode(action)

    def best(self, local: NDArray[np.float32], weights: NDArray[np.float32]) -> Actions:
        """Greedy actions, shape (B, K)."""
        worlds, count, size = local.shape
        if len(weights) == 1:
            values = q_values(self._shape, weights, local.reshape(1, worlds * count, size))
            return np.asarray(values.argmax(axis=-1).reshape(worlds, count))
        by_robot = np.ascontiguousarray(local.transpose(1, 0, 2))
        return np.asarray(q_values(self._shape, weights, by_robot).argmax(axis=-1).T)


class _Scheme:
    """What schemes have in common: networks, and what is served once all have decided."""

    def __init__(self, config: Config) -> None:
        self._config, self._service = config, Service(config)
        self._ap, self._actions = ap_network(config), robot_actions(config)

    def _values(self, weights: PolicyWeights, state: NDArray[np.float32]) -> NDArray[np.float32]:
        """Values of the access point's network, (B, actions), on states (B, global_size)."""
        return np.asarray(q_values(self._ap, weights.ap[None], state[None])[0])

    def _decided(
        self, world: World, action: Actions, direction: Actions, picks: Actions
    ) -> Decision:
        """What comes of the access point's actions, (B,), and the robots' directions and picks."""
        phase, level = self._service(world, action, picks)
        return Decision(phase, direction, level)


class _Federated(_Scheme):
    """F-DRL: the access point's network, and the robots'."""

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self._robots = RobotNetworks(config)

    def __call__(self, world: World, weights: PolicyWeights, exploration: Exploration) -> Decision:
        local = world.local_observations()
        values = self._values(weights, world.global_observation(local))
        action = exploration(values.argmax(axis=-1), self._ap.actions)
        return self._decided(world, action, *self._robots(local, weights.robots, exploration))


class _Ruled(_Scheme):
    """A rule sets the phases: nothing of it is left to chance but what the rule itself draws.

    The robots have their networks, or drive shortest ways with powers by rank or the best ones.
    """

    def __init__(self, config: Config, world: World) -> None:
        super().__init__(config)
        self._rule, self._drive = config.scheme.phase, config.scheme.robots
        self._robots, self._fixed = RobotNetworks(config), np.array(phase_of(config, world))

    def __call__(self, world: World, weights: PolicyWeights, exploration: Exploration) -> Decision:
        if self._drive == "shortest_best":
            weights_5a = per_slot.objective_weights(world, world.travel_slots)
            phase, level = per_slot.best_phase_and_powers(world, weights_5a)
            return Decision(phase, per_slot.shortest_directions(world), level)
        phase = np.broadcast_to(self._fixed, len(world.cell))
        if self._rule == "random":
            phase = exploration.phases(world.phase_actions)
        if self._drive == "learned":
            decided = self._robots(world.local_observations(), weights.robots, exploration)
            return self._decided(world, phase, *decided)
        return self._by_rank(world, phase)

    def _by_rank(self, world: World, phase: Actions) -> Decision:
        """Shortest ways with canonical powers, which follow from the phase."""
        levels, direction = world.config.power.levels, per_slot.shortest_directions(world)
        gains, driving = per_slot.phase_gains(world), world.driving[:, None]
        by_phase = per_slot.canonical_levels(gains, driving, levels)
        if self._rule == "oracle":
            phase = per_slot.best_phase(world, by_phase)
        return Decision(phase, direction, by_phase[np.arange(len(phase)), phase])


class _Joint(_Scheme):
    """A centralized DQN: its one action is random as a whole, or not at all."""

    def __call__(self, world: World, weights: PolicyWeights, exploration: Exploration) -> Decision:
        values = self._values(weights, world.global_observation())
        joint = exploration(values.argmax(axis=-1), self._ap.actions)
        action, robots = self._actions.joint_decode(joint, self._config.env.robots)
        return self._decided(world, action, *self._actions.decode(robots))


class _Heads(_Scheme):
    """One network with several heads: each explores by itself, as agents of their own do."""

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self._heads = central_heads(config)

    def __call__(self, world: World, weights: PolicyWeights, exploration: Exploration) -> Decision:
        values = self._values(weights, world.global_observation())
        best, (own, each) = self._heads.best(values), self._heads.sizes[:2]
        action = exploration(best[:, 0].copy(), own)
        robots = exploration(best[:, 1:].copy(), each)
        return self._decided(world, action, *self._actions.decode(robots))
