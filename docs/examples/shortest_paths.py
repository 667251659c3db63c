"""NOMA and OMA along shortest paths: the numbers (w) of docs/assumptions.md."""

from dataclasses import replace

import numpy as np

from env.config import EnvConfig, OmaConfig, PowerConfig, TasksConfig
from env.episode import EpisodeAccumulator
from env.oracles import per_slot
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World


def shortest_ways(config, best_powers=False, for_ee=False, worlds=200):
    """Means over episodes on shortest paths, best phase, canonical or best powers; low rates."""
    world = World(Scenario.drawn(config, 0), stream(0, Stream.WORLD), worlds)
    world.reset()
    counted, rows, low = EpisodeAccumulator(world), np.arange(worlds), 0
    weights = per_slot.objective_weights(world, world.shortest_slots) if for_ee else None
    while world.driving.any():
        gain, driving = per_slot.phase_gains(world), world.driving[:, None]
        level = per_slot.canonical_levels(gain, driving, config.power.levels)
        phase = per_slot.best_phase(world, level, weights)
        picks = level[rows, phase]
        if best_powers:
            phase, picks = per_slot.best_phase_and_powers(world)
        direction = per_slot.shortest_directions(world)
        result = world.step(phase, direction, picks)
        low += (result.drove & (result.rate < config.qoe.floor)).sum()
        counted.add(result)
    return {**counted.measures().summary(), "low": low}


def over_maps(name, config, **how):
    """Prints means over map seeds 0 to 4, and the least and the largest."""
    found = [shortest_ways(replace(config, map_seed=seed), **how) for seed in range(5)]
    print(name)
    for key in ("ee", "ee_bits_per_joule", "sum_rate", "min_rate", "reward", "slots", "low"):
        values = [one[key] for one in found]
        print(f"  {key}: {np.mean(values):.4f} ({min(values):.4f} to {max(values):.4f})")


for robots in (3, 4):
    noma, oma = EnvConfig(robots=robots), EnvConfig(robots=robots, access="oma")
    more = PowerConfig(max_dbm=20.0 + 10.0 * np.log10(robots))
    over_maps(f"K = {robots}, NOMA", noma)
    over_maps(f"K = {robots}, OMA, fixed", oma)
    again = replace(oma, oma=OmaConfig("reallocate"))
    over_maps(f"K = {robots}, OMA, reallocate", again)
    over_maps(f"K = {robots}, NOMA, phases for (5a)", noma, for_ee=True)
    over_maps(f"K = {robots}, OMA, reallocate, phases for (5a)", again, for_ee=True)
    over_maps(f"K = {robots}, OMA, fixed, P_max for each", replace(oma, power=more))
for metric in ("qos", "qoe"):
    over_maps(metric, EnvConfig(metric=metric), best_powers=True)
for destination in ("fixed", "random", "common"):
    over_maps(destination, EnvConfig(tasks=TasksConfig(destination=destination)))
