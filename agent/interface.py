"""What agents ask of a learner, which is their own or one that several runs share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from agent.config import AgentConfig
from agent.network import FloatArray, NetworkShape
from agent.priority import Weighing


class Learns(Protocol):
    """What agents ask of a learner: `Learner`, or a seat in a stack of several runs.

    Attributes and methods are those of `agent.learner.Learner`.
    """

    weights: FloatArray
    moments: FloatArray
    steps: FloatArray
    anchor: FloatArray
    batch: FloatArray
    weighing: Weighing | None

    def update(self, learning: Sequence[bool]) -> FloatArray:
        """See `Learner.update`."""
        ...

    def copy_to_target(self, agent: int) -> None:
        """See `Learner.copy_to_target`."""
        ...

    def choose(self, observations: FloatArray, choices: NDArray[np.int32]) -> None:
        """See `Learner.choose`."""
        ...


class MakeLearner(Protocol):
    """Makes a learner, as `Learner` itself does."""

    def __call__(
        self,
        shape: NetworkShape,
        config: AgentConfig,
        discount: float,
        agents: int,
        proximal_mu: float = 0.0,
    ) -> Learns:
        """See `Learner.__init__`."""
        ...
