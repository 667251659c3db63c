"""What a coordinator asks of whoever steers the RIS, and what is sent in a slot for that."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conf import Config
from env.downlink.combinations import deal, levels_by_rank
from env.oracles import per_slot
from env.world import StepResult, World

States = NDArray[np.float32]
"""Observations of B worlds, shape (B, global_size)."""

Actions = NDArray[np.int64]

Served = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Phase settings, shape (B,), and power levels, shape (B, K)."""


class Service:
    """From what was chosen to what is served, in any number of worlds.

    By ``scheme.power``:

    * ``robots``: the phase that was chosen, and the robots' picks; an oracle's phase is the best
      one for these picks.
    * ``ap``: an action is a phase setting and a combination of powers, which is dealt by rank.
    * ``search``: the best powers under the phase that was chosen; an oracle's phase and powers are
      searched together.
    """

    def __init__(self, config: Config) -> None:
        self._power, self._oracle = config.scheme.power, config.scheme.phase == "oracle"
        if self._power == "ap":
            robots = config.env.robots
            self._levels = levels_by_rank(config.env, robots, robots)

    def __call__(self, world: World, action: NDArray[np.int64], picks: NDArray[np.int64]) -> Served:
        """What is served in a slot.

        Args:
            world: B worlds; not changed.
            action: the access point's, below ``conf.ap_actions``, shape (B,); not read where the
                phase is an oracle's.
            picks: the robots' power levels, shape (B, K); read where robots pick powers.
        """
        if self._power == "ap":
            phase, combination = np.divmod(action, len(self._levels))
            gain = per_slot.gains(world, phase)
            return phase, deal(self._levels[combination], gain, world.driving)
        if self._power == "search":
            if self._oracle:
                return per_slot.best_phase_and_powers(world, world.rate_weights)
            return action, per_slot.best_powers(world, action, world.rate_weights)
        return (per_slot.best_phase(world, picks) if self._oracle else action), picks


class RisController(ABC):
    """Who sets the RIS's phases: a DQN, a rule, or one agent that decides for the robots, too.

    Attributes:
        serve: what is set once the robots' power picks are known.
    """

    def __init__(self, config: Config) -> None:
        self._config, self.serve = config, Service(config)

    @abstractmethod
    def act(self, state: States, tick: int) -> NDArray[np.integer[Any]]:
        """Chooses actions, shape (B,): phase settings, or such with a combination of powers."""

    @abstractmethod
    def learn(self, state: States, action: Actions, outcome: StepResult, seen: States) -> None:
        """Learns from the outcome of ``act``'s actions and what is seen then, B rows each."""

    @abstractmethod
    def weights(self) -> NDArray[np.float32]:
        """Online and target weights, float32, shape (2, P)."""

    @abstractmethod
    def state(self) -> dict[str, NDArray[Any]]:
        """All that the agent needs to go on from a window boundary, as copies."""

    @abstractmethod
    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave."""
