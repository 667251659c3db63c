"""The pictures of docs/floor_plans.md."""

import numpy as np

from env.checks import checked_config
from env.oracles import per_slot
from env.rendering.drawing import trajectory_figure
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World

for plan in ("corridor", "hall"):
    scenario = Scenario.drawn(checked_config({"plan": plan}), seed=0)
    world = World(scenario, stream(0, Stream.WORLD))
    world.reset()
    cells = [world.cell]
    while world.driving.any():
        direction = per_slot.shortest_directions(world)
        world.step(np.zeros(1, dtype=int), direction, np.ones_like(direction))
        cells.append(world.cell)
    centres = world.floor.centres()
    goals, title = centres[scenario.destinations], f"env.plan={plan}"
    figure = trajectory_figure(
        scenario.config, scenario.radio_map, centres[np.stack(cells)], goals, [title]
    )
    figure.savefig(f"docs/images/plan_{plan}.png", dpi=140)
