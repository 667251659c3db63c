"""What the infos of the fleet's environment hold of a slot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from env.arrays import Complexes
from env.world import StepResult, World

AP = "ap"
"""The access point's name among the agents."""

Infos = dict[str, dict[str, Any]]


class FleetInfos:
    """Infos by agent, for a world of one copy.

    Args:
        world: the world.
        robots: their names.
        masks: whether infos tell which actions count, and which robots are driving.
    """

    def __init__(self, world: World, robots: Sequence[str], *, masks: bool) -> None:
        self._world, self._robots, self._masks = world, robots, masks

    def of(self, channel: Complexes, outcome: StepResult | None = None) -> Infos:
        """The infos of a slot, with h_k in it, shape (K,); of none after a reset."""
        nothing = np.zeros(len(self._robots))
        sent = outcome.allocation if outcome else None
        columns = {
            "rate": outcome.rate[0] if outcome else nothing,
            "power_w": sent.power_w[0] if sent else nothing,
            "gain_db": 20.0 * np.log10(np.abs(channel)),
            "sic_failed": sent.sic_failed[0] if sent else nothing.astype(bool),
            "arrived": outcome.arrived[0] if outcome else nothing.astype(bool),
            "shortest_slots": self._world.shortest_slots[0],
        }
        infos: Infos = {
            name: {key: column[k].item() for key, column in columns.items()}
            for k, name in enumerate(self._robots)
        }
        infos[AP] = {
            "sum_rate": float(columns["rate"].sum()),
            "projected": bool(sent.projected[0]) if sent else False,
            "margin_dropped": bool(sent.margin_dropped[0]) if sent else False,
        }
        if self._masks:
            self._mask(infos)
        return infos

    def _mask(self, infos: Infos) -> None:
        """Adds the actions that count for each agent, and which robots are driving."""
        world = self._world
        infos[AP]["action_mask"] = np.ones(world.phase_actions, dtype=np.int8)
        for name, driving in zip(self._robots, world.driving[0].tolist(), strict=True):
            mask = np.ones(world.scenario.actions.count, dtype=np.int8)
            if not driving:
                mask[1:] = 0
            infos[name] |= {"action_mask": mask, "driving": driving}
