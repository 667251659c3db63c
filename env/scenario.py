"""What a configuration fixes before the first slot: built once, and handed to whoever needs it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from env.arrays import Floats, Floats32, Ints
from env.config import EnvConfig
from env.geometry import distances
from env.geometry.floor import Floor
from env.mdp import starts
from env.mdp.actions import ActionSpace
from env.mdp.destinations import draw_destinations
from env.mdp.observation import ObservationEncoder
from env.mdp.reward import RewardFunction
from env.radio.radio_map import RadioMap, build_radio_map
from env.seeding import Stream, stream

MAX_SEEN = 2**20
"""Most cells times robots for which observations are tabulated: 54 MB, 75 MB with ways."""


class ObservationTables(NamedTuple):
    """What is seen from every cell, where that depends on a robot and its cell alone.

    Attributes:
        local: s_L without what the AP tells, shape (cells, K, size).
        by_ap: what the AP sees of a robot while it drives, shape (cells, K, size).
    """

    local: Floats32
    by_ap: Floats32


class Scenario:
    """Floor, destinations, distances, radio map, observations, actions and rewards of K robots.

    Nothing of it changes while robots drive, so worlds and robots may share it. Tables that are
    costly are built when they are first asked for: a robot's side needs no radio map.

    Args:
        config: the environment.
        destinations: the cell that each robot is going to, shape (K,).
        radio_map: tables to use; built when they are first asked for if None.

    Attributes:
        floor: its cells and walls.
        actions: what a robot can choose.
        observer: makes observations.
        rewards: makes rewards.
        slot_s: length of a slot in s.
    """

    def __init__(
        self, config: EnvConfig, destinations: Ints, radio_map: RadioMap | None = None
    ) -> None:
        self.config, self.destinations = config, destinations
        self.floor = Floor.from_config(config)
        self.actions = ActionSpace.from_config(config)
        self.observer = ObservationEncoder(config)
        self.rewards = RewardFunction(config)
        self.slot_s = config.room.cell_m / config.motion.speed_mps
        self._radio_map = radio_map

    @classmethod
    def drawn(cls, config: EnvConfig, seed: int) -> Scenario:
        """A run's scenario: its destinations come from their stream of the run's seed.

        Raises:
            ValueError: see ``draw_destinations``.
        """
        return cls(config, draw_destinations(config, stream(seed, Stream.DESTINATIONS)))

    def of(self, robots: Sequence[int]) -> Scenario:
        """The scenario as some of the robots know it: with their own destinations alone."""
        return Scenario(self.config, self.destinations[list(robots)])

    @cached_property
    def radio_map(self) -> RadioMap:
        """The channels of all cells."""
        return self._radio_map or build_radio_map(self.config, self.floor)

    @cached_property
    def next_cell(self) -> Ints:
        """The cell that each move leads to, shape (cells, 4)."""
        return self.floor.neighbours()

    @cached_property
    def slots_to_go(self) -> Ints:
        """Fewest slots from each cell to each destination, shape (cells, K).

        ``UNREACHABLE`` where solid walls leave no way.
        """
        return self.floor.slots_to(self.destinations)

    @cached_property
    def distance_m(self) -> Floats:
        """D of the rewards: from each cell to each destination in m, shape (cells, K)."""
        return distances.distances_m(self.floor, self.destinations, self.config.reward.distance)

    def local_states(self, cell: Ints, channel_db: Floats32) -> Floats32:
        """What each robot knows by itself of s_L, the same on the world's side and on the robots'.

        Args:
            cell: where each robot is, shape (..., K).
            channel_db: |hbar_k|^2 in dB, shape (..., K).

        Returns:
            States, shape (..., K, size).
        """
        way = None
        if self.observer.has_way:
            robot = np.arange(len(self.destinations))
            then = self.slots_to_go[self.next_cell[cell], robot[:, None]]
            way = self.observer.way(self.slots_to_go[cell, robot], then)
        return self.observer.local(cell, channel_db, self.destinations, way)

    @cached_property
    def tables(self) -> ObservationTables | None:
        """Observations from all cells; None where channels change by the slot or it is large."""
        cells, robots = self.distance_m.shape
        if self.config.channel.fading == "slot" or cells * robots > MAX_SEEN:
            return None
        cell = np.broadcast_to(np.arange(cells)[:, None], (cells, robots))
        direct, everywhere = self.radio_map.direct[cell], np.ones(cell.shape, dtype=bool)
        local = self.local_states(cell, self.radio_map.direct_db[cell])
        return ObservationTables(local, self.observer.seen_robots(local, direct, everywhere))

    @cached_property
    def start_cells(self) -> list[Ints]:
        """The cells that each robot may start from; see ``starts.start_cells``."""
        return starts.start_cells(self.config, self.floor, self.destinations)

    @cached_property
    def fixed_starts(self) -> Ints:
        """The cells that robots start from with ``tasks.start=fixed``, shape (K,), or none."""
        return starts.fixed_starts(self.config, self.floor)

    def draw_starts(self, count: int, generator: np.random.Generator) -> Ints:
        """Start cells, shape (count, K): fixed ones, or drawn as ``tasks.start`` says."""
        if len(self.fixed_starts):
            return np.tile(self.fixed_starts, (count, 1))
        if self.config.collisions == "block":
            return starts.distinct_starts(self.start_cells, count, generator)
        drawn = [generator.choice(cells, size=count) for cells in self.start_cells]
        return np.stack(drawn, axis=-1)
