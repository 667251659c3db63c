"""What agents ask of a learner, whatever its networks are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from agent.networks.mlp import FloatArray
from agent.replay.prioritised import ImportanceWeights


class Learns(Protocol):
    """What agents ask of a learner: `Learner`, or one of networks with several heads.

    Attributes and methods are those of `agent.learning.learner.Learner`.
    """

    weights: FloatArray
    moments: FloatArray
    steps: FloatArray
    proximal_reference: FloatArray
    batch: FloatArray
    weighing: ImportanceWeights | None

    def update(self, learning: Sequence[bool]) -> FloatArray:
        """See `Learner.update`."""
        ...

    def copy_to_target(self, agent: int) -> None:
        """See `Learner.copy_to_target`."""
        ...

    def choose(self, observations: FloatArray, choices: NDArray[np.int32]) -> None:
        """See `Learner.choose`."""
        ...
