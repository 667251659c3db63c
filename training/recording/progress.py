"""Where a run is, and whoever watches it."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from conf.schema import TrainConfig
from env.episode import EpisodeMeasures


@dataclass
class Progress:
    """Where a run is: counters that belong to its state.

    Attributes:
        tick: joint steps taken.
        window: aggregations made.
        episodes: training episodes that have ended.
    """

    tick: int = 0
    window: int = 0
    episodes: int = 0

    def counters(self) -> NDArray[Any]:
        """As a checkpoint has it."""
        return np.array(astuple(self))

    @classmethod
    def of(cls, counters: NDArray[Any]) -> Progress:
        """What ``counters`` gave."""
        return cls(*counters.tolist())

    def reaches(self, train: TrainConfig) -> bool:
        """Whether a run that is to be so long is over."""
        late = train.max_ticks is not None and self.tick >= train.max_ticks
        return late or self.episodes >= train.episodes


class Observer(Protocol):
    """Whoever watches a run."""

    def on_start(self) -> None:
        """Every robot has joined and the first tick begins."""
        ...

    def on_episode(self, progress: Progress, measures: EpisodeMeasures) -> None:
        """A training episode has ended."""
        ...

    def on_window(
        self, progress: Progress, robots: NDArray[np.float32], ap: NDArray[np.float32]
    ) -> None:
        """Weights after aggregation: robots (K, 2, P), or (1, 2, P) if all are the same."""
        ...
