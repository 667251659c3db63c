"""Access points that learn nothing: a random phase, the best fixed one, the best of each slot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conf import Config
from env.mdp.reward import metric
from env.oracles import per_slot
from env.seeding import Stream, stream
from env.world import StepResult, World
from storage.generators import generator_state, restore_generator
from training.controllers.service import Actions, RisController, States

PLACEMENTS = 2000
"""Random placements of the robots over which the best fixed phase is the best on average."""


def fixed_phase(world: World, map_seed: int) -> int:
    """The phase action with the largest mean sum of the metric over the floor.

    The mean is over random placements of K robots on the drivable floor, all driving, with
    canonical powers: what can be known of a map without any task on it. Placements are the map's;
    of equal actions it is the lowest. Of the world only the tables are read.
    """
    generator = stream(map_seed, Stream.RADIO_MAP, 2)
    cells = np.flatnonzero(world.floor.drivable())
    cell = generator.choice(cells, size=(PLACEMENTS, world.robots))
    everyone = np.ones(cell.shape, dtype=bool)

    def mean(phase: int) -> float:
        gain = world.radio_map.gain(cell, np.full(PLACEMENTS, phase))
        level = per_slot.canonical_levels(gain, everyone, world.config.power.levels)
        rate = world.downlink.allocate(gain, level, everyone).rate
        return float(metric(rate, world.config).sum(axis=-1).mean())

    return int(np.argmax([mean(phase) for phase in range(world.phase_actions)]))


class PhaseRule(RisController):
    """An access point with a rule in the place of its DQN: it has no weights and learns nothing.

    By ``scheme.phase``: random, fixed, or an oracle's, the best once picks are known.
    """

    def __init__(self, config: Config, world: World) -> None:
        super().__init__(config)
        self._actions, self._worlds = world.phase_actions, config.train.worlds
        self._generator = stream(config.seed, Stream.AP)
        self._fixed = np.full(self._worlds, phase_of(config, world))

    def act(self, state: States, tick: int) -> Actions:
        """See ``RisController.act``."""
        if self._config.scheme.phase == "random":
            return self._generator.integers(self._actions, size=self._worlds)
        return self._fixed

    def learn(self, state: States, action: Actions, outcome: StepResult, seen: States) -> None:
        """See ``RisController.learn``."""

    def weights(self) -> NDArray[np.float32]:
        """See ``RisController.weights``: none."""
        return np.zeros((2, 0), np.float32)

    def state(self) -> dict[str, NDArray[Any]]:
        """See ``RisController.state``."""
        return {"generator": generator_state(self._generator)}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """See ``RisController.restore``."""
        restore_generator(self._generator, state["generator"])


def phase_of(config: Config, world: World) -> int:
    """The phase action of ``scheme.phase=fixed``; 0 where another rule sets phases."""
    return fixed_phase(world, config.env.map_seed) if config.scheme.phase == "fixed" else 0
