"""Oracle policies on held-out starts, and how far a frozen policy is from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from env.episode import EpisodeAccumulator, EpisodeMeasures
from env.oracles import per_slot
from env.oracles.trajectory import best_trajectory, shortest_ways
from env.seeding import Stream, stream
from env.world import World
from training.controllers.service import Served
from training.evaluation import Evaluator

SLACK = 4

SHORTEST = "shortest, "
RANDOM = SHORTEST + "random phase"
FIXED = SHORTEST + "fixed phase"
PHASE = SHORTEST + "best phase"
POWERS = SHORTEST + "best powers"
TRAJECTORY = "trajectory"
POLICY = "policy"
POLICY_PHASE = "policy, best phase"
POLICY_POWERS = "policy, best powers"
STEPS = (POLICY, POLICY_PHASE, POLICY_POWERS, TRAJECTORY)
PARTS = ("phase", "power", "motion")
RESAMPLES = 2000

Measures = dict[str, EpisodeMeasures]
Watch = Callable[[World, Served], object]
Each = Callable[[Iterable[NDArray[np.int64]]], Iterable[NDArray[np.int64]]]


def ignored(world: World, served: Served) -> None:
    """Watches nothing."""


def shortest_measures(evaluator: Evaluator, seed: int) -> Measures:
    """Policies that drive shortest ways; powers are canonical unless they are searched.

    Args:
        evaluator: the held-out episodes.
        seed: of the random phases.

    Returns:
        By name. The best fixed phase is the one setting with the largest mean energy efficiency
        over these episodes.
    """
    world, starts = evaluator.world, evaluator.starts
    settings, levels, count = world.phase_actions, world.config.power.levels, len(starts)
    generator = stream(seed, Stream.EVALUATION, 3)
    weights = _weights(world, starts)

    def canonical(phase: NDArray[np.int64]) -> Served:
        gain = world.radio_map.gain(world.cell, phase)
        return phase, per_slot.canonical_levels(gain, world.driving, levels)

    def by_phase(world: World) -> Served:
        gains, driving = per_slot.phase_gains(world), world.driving[:, None]
        level = per_slot.canonical_levels(gains, driving, levels)
        phase = per_slot.best_phase(world, level, weights)
        return phase, level[np.arange(len(phase)), phase]

    def fixed(setting: int) -> EpisodeMeasures:
        phase = np.full(count, setting)
        return _played(world, starts, lambda _: canonical(phase))

    return {
        RANDOM: _played(
            world, starts, lambda _: canonical(generator.integers(settings, size=count))
        ),
        FIXED: max(map(fixed, range(settings)), key=lambda found: float(found.ee.mean())),
        PHASE: _played(world, starts, by_phase),
        POWERS: shortest_best_measures(evaluator),
    }


def shortest_best_measures(evaluator: Evaluator, watch: Watch = ignored) -> EpisodeMeasures:
    """The best rule: shortest ways, with the phases and powers that serve the objective (5a) best.

    Args:
        evaluator: the held-out episodes.
        watch: is shown the world in every slot before it moves on, with what is served in it.
    """
    weights = _weights(evaluator.world, evaluator.starts)

    def serve(world: World) -> Served:
        served = per_slot.best_phase_and_powers(world, weights)
        watch(world, served)
        return served

    return _played(evaluator.world, evaluator.starts, serve)


def _weights(world: World, starts: NDArray[np.int64]) -> NDArray[np.float64]:
    """What rates count for in (5a) on shortest ways from cells, (B, K), same shape."""
    return per_slot.objective_weights(world, world.slots_to_go[starts, np.arange(world.robots)])


def _played(
    world: World, starts: NDArray[np.int64], serve: Callable[[World], Served]
) -> EpisodeMeasures:
    """Plays shortest ways with phases and powers of a kind."""
    world.reset(starts)
    tally = EpisodeAccumulator(world)
    for _ in range(world.config.motion.max_slots):
        phase, level = serve(world)
        outcome = world.step(phase, shortest_ways(world, world.cell), level)
        tally.add(outcome)
        if outcome.terminated.all():
            break
    return tally.measures()


def trajectory_measures(
    evaluator: Evaluator,
    slack: int,
    each: Each = iter,
    watch: Watch = ignored,
    planned_in: World | None = None,
) -> EpisodeMeasures:
    """Plans every held-out episode and plays the plans.

    Args:
        evaluator: the held-out episodes.
        slack: extra slots that a robot may take.
        each: goes through the starts, and may show how far it is.
        watch: as in ``shortest_best_measures``.
        planned_in: the world as the planner knows it; the one that is played in if None.
    """
    world, known = evaluator.world, planned_in or evaluator.world
    plans = [best_trajectory(known, start, slack) for start in each(evaluator.starts)]
    world.reset(evaluator.starts)
    tally = EpisodeAccumulator(world)
    for slot in range(max(len(plan.phase) for plan in plans)):
        at = [min(slot, len(plan.phase) - 1) for plan in plans]  # its last slot once it has ended
        phase, direction, level = (
            np.stack([getattr(plan, part)[i] for plan, i in zip(plans, at, strict=True)])
            for part in ("phase", "direction", "level")
        )
        watch(world, (phase, level))
        tally.add(world.step(phase, direction, level))
    return tally.measures()


def policy_measures(
    evaluator: Evaluator, robots: NDArray[np.float32], ap: NDArray[np.float32]
) -> Measures:
    """A greedy frozen policy, and its motion with better phases, and with better powers as well.

    Args:
        evaluator: the held-out episodes.
        robots: online weights of each robot, shape (K, P).
        ap: online weights of the access point, shape (P_AP,).
    """
    driving: list[NDArray[np.bool_]] = []

    def watch(world: World, served: Served) -> Served:
        driving.append(world.driving)
        return served

    (played,) = evaluator.play(robots, ap, (0.0,), serve=watch)
    weights = per_slot.objective_weights(evaluator.world, np.sum(driving, axis=0))

    def phases(world: World, served: Served) -> Served:
        return per_slot.best_phase(world, served[1], weights), served[1]

    def powers(world: World, _: Served) -> Served:
        return per_slot.best_phase_and_powers(world, weights)

    better = {POLICY_PHASE: phases, POLICY_POWERS: powers}
    return {POLICY: played} | {
        name: evaluator.play(robots, ap, (0.0,), serve=serve)[0] for name, serve in better.items()
    }


def gap(measures: Measures, seed: int) -> dict[str, dict[str, float]]:
    """The optimality gap in EE and its parts, by what is made best in turn.

    Args:
        measures: those of the policies ``STEPS``, of the same episodes.
        seed: of the bootstrap.

    Returns:
        Of "phase", "power", "motion" and their sum "whole": the mean over episodes in
        bit/s/Hz/J, "low" and "high" of its 95 % interval, and its share of the trajectory's EE.
    """
    ee = [measures[name].ee for name in STEPS]
    episodes = len(ee[0])
    parts = {name: ee[i + 1] - ee[i] for i, name in enumerate(PARTS)}
    parts["whole"] = ee[-1] - ee[0]
    drawn = stream(seed, Stream.EVALUATION, 4).integers(episodes, size=(RESAMPLES, episodes))
    found = {}
    for name, values in parts.items():
        low, high = np.quantile(values[drawn].mean(axis=-1), [0.025, 0.975])
        found[name] = {"mean": float(values.mean()), "low": float(low), "high": float(high)}
    found["whole"]["mean"] = sum(found[name]["mean"] for name in PARTS)
    for each in found.values():
        each["share"] = each["mean"] / float(ee[-1].mean())
    return found
