"""Frozen networks as other code uses them: from observations to actions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent import q_values
from conf import Config, ConfigError, ap_network, robot_actions, robot_network, robots_learn
from env.downlink.combinations import count_combinations
from env.mdp.actions import ActionSpace
from env.seeding import Stream, stream
from training.controllers.policies import (
    Exploration,
    PolicyWeights,
    RobotNetworks,
    explored,
    frozen_policy,
)

if TYPE_CHECKING:
    from env.apis.parallel_env import RISFleetParallelEnv

AP = "ap"
ROBOT = "robot_"

Actions = NDArray[np.int64]
Weights = NDArray[np.float32]


class AccessPointPolicy:
    """The access point's frozen network.

    Args:
        config: the run's configuration.
        weights: its online weights, shape (P_AP,).

    Raises:
        ConfigError: it has none.
    """

    def __init__(self, config: Config, weights: Weights) -> None:
        scheme = config.scheme
        if scheme.phase != "learned" or scheme.agents != "federated":
            raise _without_network(config, "phase", "the access point no network of its own")
        self._shape, self._weights = ap_network(config), weights
        together = scheme.power == "ap"
        self._combinations = count_combinations(config.env, config.env.robots) if together else 1
        self._generator = stream(config.seed, Stream.EVALUATION, 1)

    def act(
        self,
        observations: ArrayLike,
        epsilon: float = 0.0,
        rng: np.random.Generator | None = None,
    ) -> Actions:
        """Actions of ``env.apis``: phase settings, or the beams of a codebook.

        Where the access point picks powers as well (``scheme.power=ap``), these are left out.

        Args:
            observations: s_G, shape (..., global_size): what the environment gives the agent
                ``ap``.
            epsilon: probability of a random action.
            rng: draws these; a generator of this policy's own, from the run's seed, if None.

        Returns:
            Shape (...).

        Raises:
            ValueError: observations of another size.
        """
        rows = _rows(observations, (self._shape.inputs,))
        values = q_values(self._shape, self._weights[None], rows.reshape(1, -1, rows.shape[-1]))
        best = np.asarray(values[0].argmax(axis=-1)).reshape(rows.shape[:-1])
        chosen = _explored(best, self._shape.actions, epsilon, rng or self._generator)
        return np.asarray(chosen // self._combinations)


class Policy:
    """The frozen networks of a run: each robot's, and the access point's.

    ``act`` decides as the method does when it is deployed: every agent by its own observation and
    network. ``decide`` plays what a run's evaluation plays, whatever its scheme, and so needs the
    environment: searched powers, oracles and rules look at the channels.

    Args:
        config: the run's configuration.
        robots: online weights of each robot, shape (K, P).
        ap: online weights of the access point, shape (P_AP,).
    """

    def __init__(self, config: Config, robots: Weights, ap: Weights) -> None:
        self._config, self._robots, self._ap = config, robots, ap
        self._generator = stream(config.seed, Stream.EVALUATION, 1)
        self._env: RISFleetParallelEnv | None = None
        self._explorations: dict[float, Exploration] = {}

    @cached_property
    def access_point(self) -> AccessPointPolicy:
        """The access point's network; a ``ConfigError`` if it has none."""
        return AccessPointPolicy(self._config, self._ap)

    @overload
    def act(
        self,
        observations: Mapping[str, NDArray[np.float32]],
        epsilon: float = ...,
        rng: np.random.Generator | None = ...,
    ) -> dict[str, int]: ...

    @overload
    def act(
        self,
        observations: ArrayLike,
        epsilon: float = ...,
        rng: np.random.Generator | None = ...,
    ) -> Actions: ...

    def act(
        self,
        observations: Any,
        epsilon: float = 0.0,
        rng: np.random.Generator | None = None,
    ) -> Actions | dict[str, int]:
        """Actions of ``env.apis``: direction * N_P + level - 1.

        Where robots pick no powers (``scheme.power``) the level is 1, P_max / 2: it is the access
        point that knows better, see ``decide``.

        Args:
            observations: s_L of all robots, shape (..., K, local_size), such as
                ``fleet.world.local_observations()``; or what a PettingZoo environment returned,
                from an agent's name to its observation, of any of the robots and ``ap``.
            epsilon: probability of a random action, for each agent.
            rng: draws these; a generator of this policy's own, from the run's seed, if None.

        Returns:
            Shape (..., K); or an action for each agent that was named.

        Raises:
            ValueError: observations of another size, or an agent that does not exist.
            ConfigError: an agent has no network of its own.
        """
        if isinstance(observations, Mapping):
            return self._act_by_name(observations, epsilon, rng)
        config = self._config
        if not robots_learn(config):
            raise _without_network(config, "robots", "robots no networks of their own")
        network = robot_network(config)
        rows = _rows(observations, (config.env.robots, network.inputs))
        local = rows.reshape(-1, *rows.shape[-2:])
        best = RobotNetworks(config).best(local, self._robots).reshape(rows.shape[:-1])
        chosen = _explored(best, network.actions, epsilon, rng or self._generator)
        direction, level = robot_actions(config).decode(chosen)
        return ActionSpace.from_config(config.env).encode(direction, level)

    def _act_by_name(
        self,
        observations: Mapping[str, NDArray[np.float32]],
        epsilon: float,
        rng: np.random.Generator | None,
    ) -> dict[str, int]:
        """See ``act``; what is not observed counts as zeros, and no agent sees another's."""
        names = [f"{ROBOT}{k}" for k in range(self._config.env.robots)]
        if unknown := sorted(observations.keys() - {*names, AP}):
            raise ValueError(f"{unknown[0]!r} is no agent: allowed are {', '.join(names)} and {AP}")
        chosen: dict[str, int] = {}
        if observations.keys() != {AP}:
            size = robot_network(self._config).inputs
            nothing = np.zeros(size, np.float32)
            rows = [_rows(observations.get(name, nothing), (size,)) for name in names]
            chosen = dict(zip(names, self.act(np.stack(rows), epsilon, rng).tolist(), strict=True))
        if AP in observations:
            chosen[AP] = int(self.access_point.act(observations[AP], epsilon, rng))
        return {name: chosen[name] for name in observations}

    def decide(self, fleet: RISFleetParallelEnv, epsilon: float = 0.0) -> dict[str, int]:
        """The actions of all agents that are left, as an evaluation of the run plays them.

        Args:
            fleet: made with the run's ``config.env``, or one of the same sizes; not changed.
            epsilon: probability of a random action, for every agent that learns.

        Raises:
            ConfigError: the environment is of other sizes.
        """
        if fleet is not self._env:
            self._check(fleet)
            self._env, self._frozen = fleet, frozen_policy(self._config, fleet.world)
        if epsilon not in self._explorations:
            self._explorations[epsilon] = Exploration(self._config.seed, (epsilon,), 1)
        world, weights = fleet.world, PolicyWeights(self._robots, self._ap)
        phase, direction, level = self._frozen(world, weights, self._explorations[epsilon])
        moves = world.scenario.actions.encode(direction[0], level[0])
        chosen = {**dict(zip(fleet.robots, moves.tolist(), strict=True)), AP: int(phase[0])}
        return {name: chosen[name] for name in fleet.agents}

    def _check(self, fleet: RISFleetParallelEnv) -> None:
        """Checks that the networks fit an environment."""
        own, other = _sizes(self._config), _sizes(replace(self._config, env=fleet.config))
        wrong = [f"{other[it]} {it}, not {own[it]}" for it in own if own[it] != other[it]]
        if wrong:
            say = "allowed is one like that of the run, as Run.make_env makes it"
            raise ConfigError(f"an environment with {', '.join(wrong)}: {say}.")


def _without_network(config: Config, key: str, say: str) -> ConfigError:
    """Says which key of ``scheme`` leaves an agent without a network: this, or ``agents``."""
    key = key if config.scheme.agents == "federated" else "agents"
    value = getattr(config.scheme, key)
    return ConfigError(f"scheme.{key}={value}, which leaves {say}: allowed is Policy.decide.")


def _sizes(config: Config) -> dict[str, int]:
    robot, ap = robot_network(config), ap_network(config)
    return {
        "robots": config.env.robots,
        "numbers that a robot observes": robot.inputs,
        "actions of a robot": robot.actions,
        "numbers that the access point observes": ap.inputs,
        "actions of the access point": ap.actions,
    }


def _rows(observations: ArrayLike, ends: tuple[int, ...]) -> NDArray[np.float32]:
    """Observations, whose last axes must have these lengths, in float32."""
    rows = np.ascontiguousarray(observations, dtype=np.float32)
    if rows.shape[-len(ends) :] != ends:
        allowed = ", ".join(("...", *map(str, ends)))
        raise ValueError(f"observations of shape {rows.shape}: allowed is ({allowed})")
    return rows


def _explored(best: Actions, count: int, epsilon: float, generator: np.random.Generator) -> Actions:
    if not 0.0 <= epsilon <= 1.0:
        raise ValueError(f"epsilon={epsilon}: allowed is a number from 0 to 1")
    return explored(best, count, epsilon, generator) if epsilon else best
