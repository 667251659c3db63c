"""What a step tells the robots, from the world: the records that the link carries."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from env.world import StepResult, World
from lockstep import Flag, Layout

# As NumPy's own numbers: it would look for attributes on an enum's member at every use.
OUTCOME, ARRIVED, DRIVING = (np.uint16(flag) for flag in (Flag.OUTCOME, Flag.ARRIVED, Flag.DRIVING))


class StepRecords:
    """Fills the records of K robots in E worlds, robot-major: shape (K E,)."""

    def __init__(self, layout: Layout, world: World) -> None:
        self._layout, self._world = layout, world

    def of(self, outcome: StepResult | None = None) -> np.ndarray:
        """The robots' records, filled with the results of a step, if there is one."""
        world = self._world
        updates = np.zeros(world.cell.size, dtype=self._layout.record)
        if outcome is not None:
            updates["flags"] = _by_robot(outcome.drove) * OUTCOME
            updates["flags"] |= _by_robot(outcome.arrived) * ARRIVED
            updates["outcome_cell"] = _by_robot(world.cell)
            updates["outcome_channel_db"] = _by_robot(world.measured_db)
            updates["rate"] = _by_robot(outcome.rate)
            if self._layout.credit:
                updates["credit"] = _by_robot(outcome.credit)
            if self._layout.broadcast:
                updates["outcome_broadcast"] = _by_robot(world.broadcast())
        return updates

    def observe_into(self, updates: np.ndarray, *, anew: bool = True) -> None:
        """Adds what each robot observes now, after a reset where an episode has just ended.

        If nothing has begun ``anew``, that is what the outcome led to.
        """
        world = self._world
        updates["flags"] |= _by_robot(world.driving) * DRIVING
        updates["cell"] = _by_robot(world.cell)
        updates["channel_db"] = _by_robot(world.measured_db)
        if self._layout.broadcast:
            led_to = updates["outcome_broadcast"]
            updates["broadcast"] = _by_robot(world.broadcast()) if anew else led_to


def _by_robot(values: NDArray[Any]) -> NDArray[Any]:
    """Rows of a step, shape (K E, ...), of values of shape (E, K, ...)."""
    by_robot = values.swapaxes(0, 1)
    return by_robot.reshape(values.shape[0] * values.shape[1], *values.shape[2:])
