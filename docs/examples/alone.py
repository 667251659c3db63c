"""How far robots come that know the radio map and their own place, and nothing of each other.

Each robot drives the shortest way along which it adds most to the objective (5a) on average over
where the others may be: planned, not learned, with the best phase and powers in every slot. What a
robot could learn that sees its own state s_L alone is about that. Usage: alone.py [K [SEED]].
"""

import sys

import numpy as np

from conf import compose
from env.episode import EpisodeAccumulator
from env.oracles import per_slot
from experiments.analysis.played import planned
from training.evaluation import Evaluator

PLACEMENTS, STARTS = 24, 16
robots, seed = (int(given) for given in (*sys.argv[1:], *("3", "0")[len(sys.argv) - 1 :]))
task = [f"env.robots={robots}", f"seed={seed}", "env.reward.credit=difference"]
config = compose([*task, "runtime=local"])
evaluator = Evaluator(config, episodes=STARTS)
world, generator = evaluator.world, np.random.default_rng(0)
cells, everyone = len(world.next_cell), np.arange(robots)


def served():
    """The phase and powers that serve (5a) best now."""
    weights = per_slot.objective_weights(world, world.travel_slots)
    return per_slot.best_phase_and_powers(world, weights)


def added():
    """What each robot adds in each cell on average, shape (cells, K)."""
    total = np.zeros((cells, robots))
    for _ in range(PLACEMENTS):
        for robot in range(robots):
            place = generator.choice(cells, size=(cells, robots))
            place[:, robot] = np.arange(cells)
            world.reset(place)
            world.slot = generator.integers(60, size=cells)
            phase, level = served()
            outcome = world.step(phase, np.zeros_like(level), level)
            total[:, robot] += outcome.credit[:, robot]
    return total / PLACEMENTS


def directions():
    """The next move of the best shortest way from each cell, shape (cells, K)."""
    worth, chosen = added(), np.zeros((cells, robots), dtype=int)
    for robot, to_go in enumerate(world.slots_to_go.T):
        value = np.zeros(cells)
        for slots in range(1, to_go.max() + 1):
            here = np.flatnonzero(to_go == slots)
            there = world.next_cell[here]
            ahead = np.where(to_go[there] < slots, value[there], -np.inf)
            chosen[here, robot] = ahead.argmax(axis=1)
            value[here] = worth[here, robot] + ahead.max(axis=1)
    return chosen


def played(way):
    """The measures of moves that `way` gives, means over the held-out starts."""
    world.reset(evaluator.starts)
    tally = EpisodeAccumulator(world)
    while world.driving.any():
        phase, level = served()
        tally.add(world.step(phase, way(), level))
    return tally.measures().summary()


moves = directions()
plans = planned(evaluator).measures.summary()
rule = played(lambda: per_slot.shortest_directions(world))
alone = played(lambda: moves[world.cell, everyone])
print(f"K = {robots}, seed {seed}, in % of the plans' (5a) and of their bit/J:")
for name, found in (("by themselves", alone), ("on straight shortest ways", rule)):
    shares = (100 * found[key] / plans[key] for key in ("ee", "ee_bits_per_joule"))
    print(name, *(f"{share:.1f}" for share in shares))
