"""Runs trained together in one stack against one by one, in processor time."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from agent import Learner, MakeLearner, Stack, single_threaded
from benchmarks.local import Unwatched, configured, initial_weights
from benchmarks.result import Result, micro, take_turns
from client_app.robots import RobotGroup
from conf import Config
from env.destinations import draw_destinations
from env.radio_map import RadioMap, build_radio_map
from env.seeding import Stream, stream
from env.world import World
from experiments.local import InProcessFleet
from server_app.access_point import AccessPoint
from server_app.coordinator import Coordinator
from server_app.strategies import build_aggregator
from server_app.turns import Turns

SIZES = ((3, 2), (3, 3), (3, 5), (1, 5))
"""Robots and runs."""
HOW = (
    "joint steps per processor second of {} runs together over one alone, {} robots and AP,"
    " replay filled, no files and no evaluations"
)


class Company:
    """Runs that take turns, from one pause to the next.

    Args:
        config: of all but for the seed.
        radio_map: tables to share.
        runs: how many.
        stacks: the robots' and the access points'; None where a run is alone.
    """

    def __init__(
        self,
        config: Config,
        radio_map: RadioMap,
        runs: int,
        stacks: tuple[Stack, Stack] | None = None,
    ) -> None:
        self._stacks = stacks or ()
        self._runs = [
            _run(
                dataclasses.replace(config, seed=seed),
                radio_map,
                [stack.seat(seed) for stack in self._stacks] or [Learner, Learner],
            )
            for seed in range(runs)
        ]

    def __call__(self, pauses: int) -> None:
        """Takes as many turns of every run: one a tick, and one more a window."""
        for _ in range(pauses):
            for run in self._runs:
                next(run)
            for stack in self._stacks:
                stack.catch_up()


def together(*, quick: bool = False) -> list[Result]:
    """Measures ``together_k*_e*``; each beside a single run of the same kind."""
    single_threaded()
    turns, blocks = (26, 3) if quick else (104, 15)
    results = []
    for robots, runs in SIZES[:1] if quick else SIZES:
        config = configured(f"env.robots={robots}")
        radio_map = build_radio_map(config.env)
        variants = {
            "alone": Company(config, radio_map, 1),
            "together": Company(config, radio_map, runs, (Stack(runs), Stack(runs))),
        }
        for variant in variants.values():
            variant(2 * config.agent.learn_from)
        taken = take_turns(variants, turns, blocks)
        each = taken["together"] / runs
        details = {
            "alone_us_per_joint_step": micro(taken["alone"]),
            "together_us_per_joint_step": micro(each),
        }
        name, how = f"together_k{robots}_e{runs}", HOW.format(runs, robots)
        results.append(
            Result.over(name, np.asarray(taken["alone"] / each), "ratio", how, None, details)
        )
    return results


def _run(config: Config, radio_map: RadioMap, make: Sequence[MakeLearner]) -> Turns[np.ndarray]:
    """A run without a folder, up to its first pause."""
    robots = tuple(range(config.env.robots))
    group = RobotGroup(config, robots, make[0])
    group.download(0, initial_weights(config))
    destinations = draw_destinations(config.env, stream(config.seed, Stream.DESTINATIONS))
    generator = stream(config.seed, Stream.WORLD)
    world = World(config.env, destinations, generator, 1, radio_map)
    run = Coordinator(
        config,
        world,
        AccessPoint(config, make[1]),
        InProcessFleet([(robots, group)]),
        build_aggregator(config.strategy, config.env.robots),
        Unwatched(),
    )
    return run.turns(initial_weights(config))
