"""What a run tells an experiment tracker, whichever it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from conf import Config


class Tracker(Protocol):
    """A tracker of one run, or of one more part of it: a resumed run goes on in the same record.

    Nothing of it draws from a global random generator or changes what the run computes. Any of
    its methods may fail: the run then goes on without it.
    """

    name: str
    """As a user knows it."""

    def start(self, config: Config) -> None:
        """Opens the run's record, or the one that an earlier part of the run has begun."""
        ...

    def log(self, step: int, scalars: Mapping[str, float]) -> None:
        """Adds finite values by their names, such as ``train/reward``, at a tick."""
        ...

    def finish(self, summary: Mapping[str, Any] | None) -> None:
        """Closes the record, whatever was opened of it, and ends what was started for it.

        The summary is that of ``summary.json``; None if the run did not come to its end.
        """
        ...


def results(summary: Mapping[str, Any]) -> dict[str, float]:
    """What the final weights are worth, by names such as ``final/greedy/success``.

    What is no number is kept: it takes the place of what an earlier part of the run came to.
    """
    return {
        f"final/{kind}/{name}": value
        for kind, measures in summary["evaluation"].items()
        for name, value in measures.items()
    }
