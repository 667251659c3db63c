"""How far robots come that know the radio map and their own place, and nothing of each other.

Each robot drives the shortest way along which it adds most to the objective (5a) on average over
where the others may be: planned, not learned, with the best phase and powers in every slot. What a
robot could learn that sees its own state s_L alone is about that. Usage: alone.py [K].
"""

import sys

import numpy as np

from conf import compose
from env.episode import EpisodeAccumulator
from env.oracles import per_slot
from env.oracles.trajectory import best_trajectory
from training.evaluation import Evaluator

PLACEMENTS, STARTS = 24, 16
robots = int(sys.argv[1]) if len(sys.argv) > 1 else 3
config = compose([f"env.robots={robots}", "env.reward.credit=difference", "runtime=local"])
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
    """The mean (5a) over the held-out starts, of moves that `way` gives."""
    world.reset(evaluator.starts)
    tally = EpisodeAccumulator(world)
    while world.driving.any():
        phase, level = served()
        tally.add(world.step(phase, way(), level))
    return tally.measures().ee.mean()


moves = directions()
plans = np.mean([best_trajectory(world, start).value for start in evaluator.starts])
rule = played(lambda: per_slot.shortest_directions(world))
alone = played(lambda: moves[world.cell, everyone])
print(f"K = {robots}: (5a) in % of the plans': {100 * alone / plans:.1f} by themselves,")
print(f"{100 * rule / plans:.1f} on straight shortest ways")
