"""The shared state of all robots and its joint step: the one copy of the physics in motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from env.arrays import Bools, Complexes, Floats, Floats32, Ints
from env.config import phase_actions
from env.downlink.allocation import Allocation, Downlink
from env.mdp import collisions
from env.mdp.reward import only
from env.radio.slot_fading import SlotFading
from env.scenario import Scenario


class StepResult(NamedTuple):
    """What one slot brought, for B worlds of K robots.

    Attributes:
        rate: R_k in bit/s/Hz at the cell that was left, shape (B, K).
        credit: what ``reward.credit`` puts in the place of R_k in a robot's reward: ``rate`` by
            default, shape (B, K).
        local_reward: r_{L,k}, 0 where a robot was not driving, shape (B, K).
        global_reward: r_G, shape (B,).
        drove: which robots were driving in the slot, shape (B, K).
        arrived: which robots reached their destination in it, shape (B, K).
        terminated: all robots have arrived, shape (B,).
        truncated: T_max has run out before that, shape (B,).
        allocation: powers, decoding order and decodability.
    """

    rate: Floats
    credit: Floats
    local_reward: Floats
    global_reward: Floats
    drove: Bools
    arrived: Bools
    terminated: Bools
    truncated: Bools
    allocation: Allocation


class World:
    """B independent copies of the floor, with K robots each, stepped together.

    A robot drives until it arrives; after that it takes no power, has no rate and does not move.
    Nothing resets by itself: where an outcome is truncated, the caller ends the episode.

    Args:
        scenario: all that stays as it is.
        generator: the source of starts.
        worlds: B, until ``reset`` is given starts for another number.

    Attributes:
        scenario: the same; ``config``, ``floor``, ``destinations`` and ``radio_map`` are its.
        cell: where the robots are, shape (B, K).
        driving: which robots are driving, shape (B, K).
        slot: slots since the episode began, shape (B,).
        next_cell: the cell that each move leads to, shape (cells, 4).
        slots_to_go: fewest slots from each cell to each robot's destination, ``UNREACHABLE``
            where solid walls leave no way, shape (cells, K).
    """

    def __init__(self, scenario: Scenario, generator: np.random.Generator, worlds: int = 1) -> None:
        self.scenario, self.generator = scenario, generator
        self.config, self.floor = scenario.config, scenario.floor
        self.destinations, self.radio_map = scenario.destinations, scenario.radio_map
        self.observer, self.slot_s = scenario.observer, scenario.slot_s
        self.next_cell, self.slots_to_go = scenario.next_cell, scenario.slots_to_go
        self.downlink = Downlink(self.config)
        self._rewards, self._distance_m = scenario.rewards, scenario.distance_m
        self._weighs = self._rewards.weighs_credit or self._rewards.weighs_rates
        self._robot = np.arange(len(self.destinations))
        self._tables = scenario.tables
        shape = (worlds, self.robots)
        self.cell = np.zeros(shape, dtype=np.int64)
        self.driving = np.zeros(shape, dtype=bool)
        self.slot = np.zeros(worlds, dtype=np.int64)
        channel, los = self.config.channel, self.radio_map.direct_los
        self._fading = SlotFading(los, channel.rician_k_db) if channel.fading == "slot" else None

    @property
    def robots(self) -> int:
        """K."""
        return len(self.destinations)

    @property
    def phase_actions(self) -> int:
        """The AP's actions: N_R^N, or the beams of a codebook."""
        return phase_actions(self.config.ris)

    @property
    def direct(self) -> Complexes:
        """The direct channel hbar of every robot in this slot, shape (B, K)."""
        direct = self.radio_map.direct[self.cell]
        return direct if self._fading is None else direct * self._fading.factor

    @property
    def measured_db(self) -> Floats32:
        """|hbar|^2 in dB as the robots measure it in this slot, float32, shape (B, K)."""
        if self._fading is None:
            return self.radio_map.direct_db[self.cell]
        return np.asarray(20.0 * np.log10(np.abs(self.direct)), dtype=np.float32)

    @property
    def shortest_slots(self) -> Ints:
        """Fewest slots that are left to each robot's destination, shape (B, K)."""
        return self.slots_to_go[self.cell, self._robot]

    @property
    def travel_slots(self) -> Ints:
        """T_k: slots so far and the fewest that are left, at least 1, shape (B, K)."""
        return np.asarray(np.maximum(self.slot[:, None] + self.shortest_slots, 1))

    @property
    def rate_weights(self) -> Floats:
        """What each robot's rate counts for in the access point's reward, shape (B, K).

        1, or w_k with ``reward.weights=objective``.
        """
        if self._rewards.weighs_rates:
            return self._rewards.weights(self.travel_slots)
        return np.ones(self.cell.shape)

    def channel(self, phase_action: Ints) -> Complexes:
        """The combined channel h_k of every robot in this slot, shape (B, K) or (B, A, K).

        Args:
            phase_action: the AP's action, shape (B,), or several of each world, shape (B, A) or
                (1, A).
        """
        cell, direct = self.cell, self.direct
        if phase_action.ndim > 1:
            cell, direct = cell[:, None], direct[:, None]
        return self.radio_map.channel(cell, phase_action, direct)

    def reset(
        self, start: Ints | None = None, fading: Sequence[np.random.Generator] | None = None
    ) -> None:
        """Begins an episode in every world.

        Args:
            start: cells to start from, shape (B, K), for any B; drawn if None: for each robot
                uniformly from the cells at least ``tasks.start_distance_m`` from its destination
                (with ``collisions=block``, that no earlier robot has drawn), or those of
                ``tasks.starts_m`` with ``tasks.start=fixed``.
            fading: with ``channel.fading=slot``, the source of each of as many equal blocks of
                worlds; one block with the world's own stream if None.
        """
        if start is None:
            start = self.draw_starts(len(self.slot))
        self.cell = np.array(start, dtype=np.int64)
        self.driving = np.ones_like(self.cell, dtype=bool)
        self.slot = np.zeros(len(self.cell), dtype=np.int64)
        if self._fading is not None:
            self._fading.begin(self.cell, fading or [self.generator])

    def restart(
        self,
        worlds: Bools,
        start: Ints | None = None,
        fading: Sequence[np.random.Generator] | None = None,
    ) -> None:
        """Begins an episode in some of the worlds.

        Args:
            worlds: in which, shape (B,).
            start: cells to start from, shape (n, K) for n such worlds; drawn if None.
            fading: as of ``reset``, of the blocks of those worlds; for this slot alone.
        """
        self.cell = self.cell.copy()  # whoever was given the arrays keeps what they held
        if start is None:
            start = self.draw_starts(int(np.count_nonzero(worlds)))
        self.cell[worlds] = start
        self.driving = self.driving | worlds[:, None]
        self.slot = np.where(worlds, 0, self.slot)
        if self._fading is not None:
            self._fading.redraw(worlds, self.cell[worlds], fading or [self.generator])

    def state(self) -> dict[str, NDArray[Any]]:
        """Where an episode is, as copies; without the random streams."""
        state = {"cell": self.cell, "driving": self.driving, "slot": self.slot}
        if self._fading is not None:
            state["fading"] = self._fading.state()
        return {name: array.copy() for name, array in state.items()}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave; the streams are the caller's to restore."""
        self.cell, self.driving = state["cell"].copy(), state["driving"].copy()
        self.slot = state["slot"].copy()
        if self._fading is not None:
            self._fading.restore(state["fading"])

    def draw_starts(self, count: int) -> Ints:
        """Start cells, shape (count, K): fixed ones, or drawn from the world's stream."""
        return self.scenario.draw_starts(count, self.generator)

    def local_observations(self) -> Floats32:
        """s_L of every robot, float32, shape (B, K, local_size)."""
        alone = self._known_alone()
        if not self.observer.broadcast_size:
            return alone
        told = self.observer.broadcast(alone, self.travel_slots, self.driving)
        return np.concatenate([alone, told], axis=-1)

    def broadcast(self) -> Floats32:
        """What the AP tells each robot, the end of s_L, float32, shape (B, K, broadcast_size)."""
        return self.observer.broadcast(self._known_alone(), self.travel_slots, self.driving)

    def _known_alone(self) -> Floats32:
        """What each robot knows by itself of s_L."""
        if self._tables is not None:
            return self._tables.local[self.cell, self._robot]
        return self.scenario.local_states(self.cell, self.measured_db)

    def global_observation(self, local: Floats32 | None = None) -> Floats32:
        """s_G, float32, shape (B, global_size); ``local`` saves computing s_L again."""
        seen = self._seen_robots(local)
        if not self.observer.arranges:
            return seen.reshape(len(self.cell), -1)
        weights = None
        if self.observer.has_weights:
            weights = self._rewards.weights(self.travel_slots)
        return self.observer.global_observation(seen, self.direct, self.driving, weights)

    def _seen_robots(self, local: Floats32 | None) -> Floats32:
        """What the AP sees of each robot by itself, zeros where it is not driving."""
        if self._tables is None:
            if local is None:
                local = self._known_alone()
            return self.observer.seen_robots(local, self.direct, self.driving)
        seen = self._tables.by_ap[self.cell, self._robot]
        if np.count_nonzero(self.driving) < self.driving.size:
            seen *= self.driving[..., None]
        return seen

    def step(self, phase_action: Ints, direction: Ints, level: Ints) -> StepResult:
        """One slot: channels at the cells left, order, powers, rates; then moves and rewards.

        Args:
            phase_action: the AP's action, shape (B,).
            direction: index into ``DIRECTIONS``, shape (B, K); read where driving.
            level: power level 1..N_P, shape (B, K); read where driving.
        """
        drove = self.driving
        running = np.asarray(drove.any(axis=-1))
        direct = None if self._fading is None else self.direct
        gain = self.radio_map.gain(self.cell, phase_action, direct)
        allocation = self.downlink.allocate(gain, level, drove)
        weights = self._rewards.weights(self.travel_slots) if self._weighs else None
        credit = allocation.rate
        if weights is not None and self._rewards.weighs_credit:
            absent = self._rewards.weighs_absence
            without = self.downlink.rates_without(gain, allocation) if absent else None
            credit = self._rewards.credit(allocation.rate, drove, weights, without)
        before_m = self._distance_m[self.cell, self._robot]
        moved = self.next_cell[self.cell, direction]
        if self.config.collisions == "block":
            moved = collisions.moves_without_collisions(self.cell, moved, drove, self.destinations)
        self.cell = np.where(drove, moved, self.cell)
        after_m = self._distance_m[self.cell, self._robot]
        arrived = drove & (self.cell == self.destinations)
        self.driving = drove & ~arrived
        self.slot = self.slot + running
        if self._fading is not None:
            self._fading.draw(self.cell)
        terminated = np.asarray(~self.driving.any(axis=-1))
        truncated = ~terminated & (self.slot >= self.config.motion.max_slots)
        local = self._rewards.of_robots(credit, before_m, after_m, arrived)
        shared = self._rewards.of_access_point(allocation.rate, drove, weights)
        return StepResult(
            rate=allocation.rate,
            credit=credit,
            local_reward=only(drove, local),
            global_reward=only(running, shared),
            drove=drove,
            arrived=arrived,
            terminated=terminated,
            truncated=truncated,
            allocation=allocation,
        )
