"""What is best in one slot: shortest ways, canonical powers, the best phase, the best powers.

Pure functions of the state of B worlds of K robots; nothing here steps a world. Powers and rates
come from the world's own ``Downlink``, so an oracle is bound by what binds the agents. Best is the
largest sum of the metric over the robots that drive: of R_k, or of eta_k with ``metric=qoe``.
Searches are exhaustive, A being the number of phase settings and ties going to the lowest action.
"""

from __future__ import annotations

from itertools import combinations, product
from math import comb

import numpy as np
from numpy.typing import NDArray

from env import access, reward
from env.floor import STEPS
from env.world import World

MAX_COMBINATIONS = 200_000
"""Phases times powers of one world that are searched: a few hundred MB."""


def shortest_directions(world: World) -> NDArray[np.int64]:
    """The next move of a shortest way, round solid walls too.

    Of the moves that shorten the way, one along the axis on which the destination is farther, x
    where both are equal; on that axis, or off it, one towards the destination rather than away.

    Args:
        world: B worlds; not changed.

    Returns:
        Indices into ``floor.DIRECTIONS``, shape (B, K) (of no meaning at the destination itself,
        where there is nothing left to drive).
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


def phase_gains(world: World) -> NDArray[np.float64]:
    """|h_k|^2 of every robot under every phase setting, shape (B, A, K)."""
    channel = world.channel(np.arange(world.phase_actions)[None])
    return np.asarray(channel.real**2 + channel.imag**2)


def canonical_levels(
    gain: NDArray[np.float64], driving: NDArray[np.bool_], levels: int
) -> NDArray[np.int64]:
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
    return np.asarray(np.clip(count - _ranks(gain, driving), 1, levels))


def best_phase(world: World, level: NDArray[np.int64]) -> NDArray[np.int64]:
    """The phase setting with the largest sum of the metric, given the robots' power picks.

    Args:
        world: B worlds; not changed.
        level: power levels 1..N_P, shape (B, K), or (B, A, K) where picks depend on the phase.

    Returns:
        The AP's actions, shape (B,).
    """
    gain = phase_gains(world)
    picks = level if level.ndim == gain.ndim else level[:, None]
    return np.asarray(_sum_metric(world, gain, picks, world.driving[:, None]).argmax(axis=-1))


def best_phase_and_powers(world: World) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The phase setting and power levels with the largest sum of the metric.

    With ``power.resolve=project`` the search goes over the combinations that the AP may send;
    otherwise picks stand as they are, so it goes over all N_P^n picks of the n driving robots.
    Under OMA levels have no effect: the phase alone is searched, and all levels are 1.

    Args:
        world: B worlds; not changed.

    Returns:
        The AP's actions, shape (B,), and levels, shape (B, K), 1 for a robot not driving.

    Raises:
        ValueError: phases times powers are more than ``MAX_COMBINATIONS``.
    """
    phase = np.zeros(len(world.cell), dtype=np.int64)
    level = np.ones_like(world.cell)
    gain = phase_gains(world)
    count = world.driving.sum(axis=-1)
    for driving in np.unique(count[count > 0]):
        ranked = _ranked_levels(world, int(driving))
        rows = np.flatnonzero(count == driving)
        at_once = max(1, MAX_COMBINATIONS // (world.phase_actions * len(ranked)))
        for at in np.split(rows, range(at_once, len(rows), at_once)):
            phase[at], level[at] = _search(world, gain[at], ranked, world.driving[at])
    return phase, level


def _search(
    world: World, gain: NDArray[np.float64], ranked: NDArray[np.int64], driving: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The best of A phases times C levels by rank: gain (b, A, K), ranked (C, K), driving (b, K).

    Each rank's level is dealt to the robot that holds the rank under the phase.
    """
    served = np.broadcast_to(driving[:, None], gain.shape)
    picks = np.moveaxis(ranked[:, _ranks(gain, served)], 0, 2)  # (b, A, C, K)
    sums = _sum_metric(world, gain[:, :, None], picks, served[:, :, None])
    phase, choice = np.divmod(sums.reshape(len(gain), -1).argmax(axis=-1), len(ranked))
    return phase, np.where(driving, picks[np.arange(len(gain)), phase, choice], 1)


def _ranked_levels(world: World, driving: int) -> NDArray[np.int64]:
    """Levels to try by rank, strongest first, shape (C, K); 1 at ranks past ``driving``."""
    if world.config.access == "oma":
        return np.ones((1, world.robots), dtype=np.int64)
    levels = world.config.power.levels
    projects = world.config.power.resolve == "project"
    number = comb(levels, driving) if projects else levels**driving
    if number * world.phase_actions > MAX_COMBINATIONS:
        raise ValueError(
            f"env.power.levels={levels}: with {driving} robots that is {number} combinations of"
            f" powers for each of {world.phase_actions} phase settings; allowed are"
            f" {MAX_COMBINATIONS} of both together"
        )
    falling = range(levels, 0, -1)
    chosen = combinations(falling, driving) if projects else product(falling, repeat=driving)
    ranked = np.ones((number, world.robots), dtype=np.int64)
    ranked[:, :driving] = list(chosen)
    return ranked


def _ranks(gain: NDArray[np.float64], driving: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Each robot's rank, 0 the strongest, shape (..., K)."""
    return np.argsort(access.decoding_order(gain, driving), axis=-1)


def _sum_metric(
    world: World, gain: NDArray[np.float64], picks: NDArray[np.int64], served: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """sum_k R_k or eta_k of arrays that broadcast to (..., K), as the AP would allocate them."""
    arrays = np.broadcast_arrays(gain, picks, served)
    flat = (array.reshape(-1, array.shape[-1]) for array in arrays)
    found = reward.metric(world.downlink.allocate(*flat).rate, world.config)
    driving = np.where(arrays[2], found.reshape(arrays[0].shape), 0.0)
    return np.asarray(driving.sum(axis=-1))
