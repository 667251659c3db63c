"""A model-based rival: plans on the radio map that robots measured, played in the true world."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from env.episode import EpisodeMeasures
from env.geometry.floor import UNREACHABLE
from env.oracles.gathering import gather, joined
from env.radio.measured_map import REPORT_BYTES, fuse, refuse
from env.scenario import Scenario
from env.world import World
from experiments.analysis import optimality_gap
from training.evaluation import Evaluator

Figures = dict[str, Any]


def measures(
    evaluator: Evaluator,
    seed: int,
    episodes: Sequence[int],
    noise_db: float,
    slack: int,
    each: optimality_gap.Each = iter,
) -> tuple[dict[int, EpisodeMeasures], dict[int, Figures]]:
    """Gathers, fuses, plans and plays, after each of several numbers of episodes of gathering.

    Args:
        evaluator: the held-out episodes; its world is the true one.
        seed: of what is gathered.
        episodes: numbers of episodes to gather, at least 1 each.
        noise_db: standard deviation of a measured gain in dB.
        slack: extra slots that a planned path may take.
        each: goes through the starts, and may show how far it is.

    Returns:
        By number of episodes the measures of the plans; and "cells_seen", a share of the cells
        from which some destination can be reached, and "bytes_up", of all robots together.

    Raises:
        ValueError: the fit does not know such a surface.
    """
    true = evaluator.world
    refuse(true.config.ris)
    gathered = gather(true, seed, max(episodes), noise_db)
    drivable = int((true.slots_to_go < UNREACHABLE).any(axis=-1).sum())
    found: dict[int, EpisodeMeasures] = {}
    counted: dict[int, Figures] = {}
    for number in episodes:
        reports = joined(gathered[:number])
        fused = fuse(reports, true.floor.centres(), true.radio_map.settings)
        known = World(Scenario(true.config, true.destinations, fused), true.generator)
        found[number] = optimality_gap.trajectory_measures(evaluator, slack, each, planned_in=known)
        seen = len(np.unique(reports.cell)) / drivable
        counted[number] = {"cells_seen": seen, "bytes_up": REPORT_BYTES * len(reports.cell)}
    return found, counted
