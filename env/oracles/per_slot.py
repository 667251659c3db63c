"""What is best in one slot: shortest ways, canonical powers, the best phase, the best powers.

Pure functions of the state of B worlds of K robots; nothing here steps a world. Powers and rates
come from the world's own ``Downlink``, so an oracle is bound by what binds the agents. Best is the
largest weighted sum of the metric over the robots that drive: of R_k, or of eta_k with
``metric=qoe``. Searches are exhaustive, in parts of a bounded size, A being the number of phase
settings and ties going to the lowest action.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from env.arrays import Bools, Floats, Ints
from env.downlink import access
from env.downlink.combinations import count_combinations, levels_by_rank
from env.geometry.floor import STEPS
from env.mdp import reward
from env.mdp.reward import motion_energy_j
from env.world import World

MAX_COMBINATIONS = 200_000
"""Worlds times phases times powers that are searched at once, and most powers: some 100 MB."""


def shortest_directions(world: World) -> Ints:
    """The next move of a shortest way, round solid walls too, shape (B, K).

    Of the moves that shorten the way, one along the axis on which the destination is farther, x
    where both are equal; on that axis, or off it, one towards the destination rather than away. At
    the destination itself, where nothing is left to drive, it has no meaning.
    """
    floor, goal = world.floor, world.destinations
    right = goal % floor.columns - world.cell % floor.columns
    up = goal // floor.columns - world.cell // floor.columns
    robot = np.arange(world.robots)
    there = world.slots_to_go[world.next_cell[world.cell], robot[:, None]]
    shorter = there < world.slots_to_go[world.cell, robot][..., None]
    longer = (np.abs(right) >= np.abs(up))[..., None] == (STEPS[:, 0] != 0)
    towards = right[..., None] * STEPS[:, 0] + up[..., None] * STEPS[:, 1] > 0
    return np.asarray(np.where(shorter, 1 + 2 * longer + towards, 0).argmax(axis=-1))


def phase_gains(world: World) -> Floats:
    """|h_k|^2 of every robot under every phase setting, shape (B, A, K)."""
    return _gains(world, np.arange(len(world.cell)), np.arange(world.phase_actions)[None])


def gains(world: World, phase: Ints) -> Floats:
    """|h_k|^2 of every robot under one phase setting of each world, (B,), shape (B, K)."""
    return _gains(world, np.arange(len(world.cell)), phase[:, None])[:, 0]


def _gains(world: World, rows: Ints, phases: Ints) -> Floats:
    """|h_k|^2 of b of the worlds under a phase settings, (1, a) or (b, a); shape (b, a, K)."""
    direct = world.direct[rows][:, None] if world.config.channel.fading == "slot" else None
    return world.radio_map.gain(world.cell[rows][:, None], phases, direct)


def canonical_levels(gain: Floats, driving: Bools, levels: int) -> Ints:
    """Power levels by rank: of n robots that drive, the strongest P/2^n, ..., the weakest P/2.

    Args:
        gain: |h_k|^2, shape (..., K).
        driving: which robots are driving, broadcast against ``gain``.
        levels: N_P; where n is larger, the strongest robots share level N_P.

    Returns:
        Levels 1..N_P, of the broadcast shape; 1 for a robot that is not driving.
    """
    gain, driving = np.broadcast_arrays(gain, driving)
    count = driving.sum(axis=-1, keepdims=True)
    return np.asarray(np.clip(count - access.ranks(gain, driving), 1, levels))


def best_phase(world: World, level: Ints, weights: Floats | None = None) -> Ints:
    """The AP's actions, (B,), with the largest sum of the metric, given the robots' power picks.

    Args:
        world: B worlds; not changed.
        level: power levels 1..N_P, shape (B, K), or (B, A, K) where picks depend on the phase.
        weights: of each robot in the sum, broadcast to (B, K); 1 if None.
    """
    phases, weights = np.arange(world.phase_actions)[None], _weights(world, weights)
    picks = level if level.ndim > 2 else level[:, None]
    best = np.zeros(len(world.cell), dtype=np.int64)
    for at in _parts(np.arange(len(best)), max(1, MAX_COMBINATIONS // phases.size)):
        metric = _metric(world, _gains(world, at, phases), picks[at], world.driving[at][:, None])
        best[at] = (metric * weights[at][:, None]).sum(axis=-1).argmax(axis=-1)
    return best


def best_phase_and_powers(world: World, weights: Floats | None = None) -> tuple[Ints, Ints]:
    """The AP's actions, (B,), and power levels, (B, K), with the largest sum of the metric.

    With ``power.resolve=project`` the search goes over the combinations that the AP may send;
    otherwise picks stand as they are, so it goes over all N_P^n picks of the n driving robots.
    Under OMA levels have no effect: the phase alone is searched, and all levels are 1. So is that
    of a robot that is not driving. Weights are as of ``best_phase``.

    Raises:
        ValueError: there are more powers to try than ``MAX_COMBINATIONS``.
    """
    best = best_slots(world, _weights(world, weights)[None])
    return best.phase[0], best.level[0]


def best_powers(world: World, phase: Ints, weights: Floats | None = None) -> Ints:
    """As ``best_phase_and_powers``, the power levels alone, given the AP's actions, shape (B,).

    Raises:
        ValueError: there are more powers to try than ``MAX_COMBINATIONS``.
    """
    weights = _weights(world, weights)[None]
    best = _nothing_found(world, weights)
    for at, ranked in _searches(world, 1):
        _search(world, at, phase[at, None], ranked, weights[:, at], best)
    level: Ints = best.level[0]
    return level


def objective_weights(world: World, slots: Ints) -> Floats:
    """1 / (T_k E_k), what a robot's rate counts for in (5a), of slots driven; same shape."""
    slots = np.maximum(slots, 1)
    return np.asarray(1.0 / (slots * motion_energy_j(slots * world.slot_s, world.config.motion)))


class BestSlots(NamedTuple):
    """What is best in a slot under W sets of weights.

    Attributes:
        value: the weighted sum of the metric, shape (W, B); 0 where nobody drives.
        phase: the AP's actions, shape (W, B).
        level: power levels, shape (W, B, K), 1 for a robot that is not driving.
    """

    value: Floats
    phase: Ints
    level: Ints


def best_slots(world: World, weights: Floats) -> BestSlots:
    """As ``best_phase_and_powers``, for several sets of weights, (W, B, K), in one search."""
    best, phases = _nothing_found(world, weights), np.arange(world.phase_actions)
    for at, ranked in _searches(world, len(phases)):
        for tried in _parts(phases, max(1, MAX_COMBINATIONS // len(ranked))):
            _search(world, at, tried[None], ranked, weights[:, at], best)
    return best


def _nothing_found(world: World, weights: Floats) -> BestSlots:
    """Best slots before any search, under weights (W, B, K): below all where somebody drives."""
    value = np.tile(np.where(world.driving.any(axis=-1), -np.inf, 0.0), (len(weights), 1))
    levels = np.ones(weights.shape, dtype=np.int64)
    return BestSlots(value, np.zeros(value.shape, dtype=np.int64), levels)


def _searches(world: World, phases: int) -> Iterator[tuple[Ints, Ints]]:
    """Worlds that are searched at once under so many phases, and the levels to try by rank."""
    count = world.driving.sum(axis=-1)
    for driving in np.unique(count[count > 0]):
        ranked = _ranked_levels(world, int(driving))
        at_once = max(1, MAX_COMBINATIONS // (phases * len(ranked)))
        for at in _parts(np.flatnonzero(count == driving), at_once):
            yield at, ranked


def _parts(items: Ints, size: int) -> list[Ints]:
    return np.split(items, range(size, len(items), size))


def _weights(world: World, weights: Floats | None) -> Floats:
    """Weights of shape (B, K)."""
    return np.broadcast_to(np.asarray(1.0 if weights is None else weights), world.cell.shape)


def _search(
    world: World, rows: Ints, phases: Ints, ranked: Ints, weights: Floats, best: BestSlots
) -> None:
    """Puts into ``best`` what a phases, (1, a) or (b, a), with levels by rank, (C, K), improve.

    Each rank's level is dealt to the robot that holds the rank under the phase.
    """
    gain, driving = _gains(world, rows, phases), world.driving[rows]
    served = np.broadcast_to(driving[:, None], gain.shape)
    picks = np.moveaxis(ranked[:, access.ranks(gain, served)], 0, 2)  # (b, a, C, K)
    metric = _metric(world, gain[:, :, None], picks, served[:, :, None])
    metric, at = metric.reshape(len(rows), -1, world.robots), np.arange(len(rows))
    phases = np.broadcast_to(phases, gain.shape[:2])
    for index, weight in enumerate(weights):
        sums = (metric @ weight[:, :, None])[..., 0]
        choice = sums.argmax(axis=-1)
        better = sums[at, choice] > best.value[index, rows]
        place = choice[better]
        best.value[index, rows[better]] = sums[at[better], place]
        best.phase[index, rows[better]] = phases[better, place // len(ranked)]
        found = picks.reshape(metric.shape)[at[better], place]
        best.level[index, rows[better]] = np.where(driving[better], found, 1)


def _ranked_levels(world: World, driving: int) -> Ints:
    """Levels to try by rank, strongest first, shape (C, K); 1 at ranks past ``driving``."""
    number = count_combinations(world.config, driving)
    if number > MAX_COMBINATIONS:
        raise ValueError(
            f"env.power.levels={world.config.power.levels}: with {driving} robots that is {number}"
            f" combinations of powers to search; allowed are {MAX_COMBINATIONS}"
        )
    return levels_by_rank(world.config, world.robots, driving)


def _metric(world: World, gain: Floats, picks: Ints, served: Bools) -> Floats:
    """R_k or eta_k of arrays that broadcast to (..., K), as the AP would allocate them; or 0."""
    arrays = np.broadcast_arrays(gain, picks, served)
    flat = (array.reshape(-1, array.shape[-1]) for array in arrays)
    found = reward.metric(world.downlink.allocate(*flat).rate, world.config)
    return np.where(arrays[2], found.reshape(arrays[0].shape), 0.0)
