"""What the infos of environments hold of a slot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from env.arrays import Complexes
from env.world import StepResult, World

AP = "ap"
"""The access point's name among the agents."""

Infos = dict[str, dict[str, Any]]
Columns = dict[str, NDArray[Any]]
"""Values of infos by name: a row for each world, of all its robots or of the one that is seen."""


def slot_columns(
    world: World, channel: Complexes | None = None, outcome: StepResult | None = None
) -> Columns:
    """What robots' infos hold, by name, each of shape (B, K).

    Args:
        world: B worlds after the slot.
        channel: h_k in the slot, shape (B, K); None after a reset: the direct one.
        outcome: what the slot brought; None after a reset, when nothing has been sent.
    """
    nothing, never = np.zeros(world.cell.shape), np.zeros(world.cell.shape, dtype=bool)
    sent = outcome.allocation if outcome else None
    return {
        "rate": outcome.rate if outcome else nothing,
        "power_w": sent.power_w if sent else nothing,
        "gain_db": 20.0 * np.log10(np.abs(world.direct if channel is None else channel)),
        "sic_failed": sent.sic_failed if sent else never,
        "arrived": outcome.arrived if outcome else never,
        "shortest_slots": world.shortest_slots,
    }


def fleet_infos(
    world: World,
    robots: Sequence[str],
    channel: Complexes | None = None,
    outcome: StepResult | None = None,
    *,
    masks: bool = False,
) -> Infos:
    """Infos by agent, for a world of one copy; arguments as of ``slot_columns``.

    With ``masks`` they tell which actions count, and which robots are driving.
    """
    columns = slot_columns(world, channel, outcome)
    infos: Infos = {
        name: {key: column[0, k].item() for key, column in columns.items()}
        for k, name in enumerate(robots)
    }
    infos[AP] = {
        "sum_rate": float(columns["rate"][0].sum()),
        "projected": bool(outcome.allocation.projected[0]) if outcome else False,
        "margin_dropped": bool(outcome.allocation.margin_dropped[0]) if outcome else False,
    }
    if masks:
        infos[AP]["action_mask"] = np.ones(world.phase_actions, dtype=np.int8)
        for name, driving in zip(robots, world.driving[0].tolist(), strict=True):
            mask = np.ones(world.scenario.actions.count, dtype=np.int8)
            mask[1:] = driving
            infos[name] |= {"action_mask": mask, "driving": driving}
    return infos
