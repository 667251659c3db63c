"""A wrapper that makes any Flower strategy repeat its runs, and go on after a crash."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from typing import cast

from flwr.app import ArrayRecord, ConfigRecord, Message, MetricRecord
from flwr.serverapp import Grid
from flwr.serverapp.strategy import Result, Strategy

from repeatable import checkpoints
from repeatable.checkpoints import Progress
from repeatable.isolation import seeded
from repeatable.kept import Kept
from repeatable.partitions import ClientLostError, Partitions, View
from repeatable.records import digest
from storage.checkpoint_files import Json

TRAIN, EVALUATE, SERVER = range(3)
"""Phases of a round, in their order."""
_CONFIGURE, _AGGREGATE = range(2)

_LIMIT = 2**63
"""Flower's messages carry no larger numbers."""
_LOG = logging.getLogger("flwr")

Evaluate = Callable[[int, ArrayRecord], MetricRecord | None]


class Repeatable(Strategy):
    """A strategy whose runs end in the same bits from the same seed, also after a crash.

    It sees partition k as node k + 1, replies in the order of partitions, and global generators
    seeded for each call. All clients that it asks must answer.
    """

    def __init__(
        self,
        strategy: Strategy,
        *,
        seed: int,
        state: str | os.PathLike[str] | None = None,
        clients: int | None = None,
        retries: int = 0,
    ) -> None:
        """Wraps a strategy.

        Args:
            strategy: a fresh one, which is the wrapper's from here on.
            seed: from 0 to 2^63 - 1.
            state: an absolute folder that gets a checkpoint after each round, and from which a run
                goes on that was interrupted; None or empty: neither.
            clients: partitions, all of which are waited for; None takes the nodes' word.
            retries: how often a round is played again in which a client was lost; for the same
                bits clients that keep a state need a ``state-dir``.
        """
        for name, value in (("seed", seed), ("retries", retries)):
            if not 0 <= value < _LIMIT:
                raise ValueError(f"{name}={value}: allowed is a whole number from 0 to 2^63 - 1")
        self._strategy, self._seed, self._retries = strategy, seed, retries
        self._folder = checkpoints.state_folder(state)
        self._kept = Kept(strategy)
        self._partitions = Partitions(clients)
        self._owner: dict[str, Json] = {}
        self._run = ""

    # --- A strategy -------------------------------------------------------------------------------

    def configure_train(
        self, server_round: int, arrays: ArrayRecord, config: ConfigRecord, grid: Grid
    ) -> Iterable[Message]:
        """As the strategy does, to the nodes that hold the partitions which it asks."""
        ask = self._strategy.configure_train
        return self._configured(TRAIN, ask, server_round, arrays, config, grid)

    def aggregate_train(
        self, server_round: int, replies: Iterable[Message]
    ) -> tuple[ArrayRecord | None, MetricRecord | None]:
        """As the strategy does, of replies in the order of partitions.

        Raises:
            ClientLostError: one that was asked gave no result.
        """
        ordered = self._partitions.ordered(server_round, replies)
        with self._seeded(server_round, TRAIN, _AGGREGATE):
            return self._strategy.aggregate_train(server_round, ordered)

    def configure_evaluate(
        self, server_round: int, arrays: ArrayRecord, config: ConfigRecord, grid: Grid
    ) -> Iterable[Message]:
        """See ``configure_train``."""
        ask = self._strategy.configure_evaluate
        return self._configured(EVALUATE, ask, server_round, arrays, config, grid)

    def aggregate_evaluate(
        self, server_round: int, replies: Iterable[Message]
    ) -> MetricRecord | None:
        """See ``aggregate_train``."""
        ordered = self._partitions.ordered(server_round, replies)
        with self._seeded(server_round, EVALUATE, _AGGREGATE):
            return self._strategy.aggregate_evaluate(server_round, ordered)

    def _configured(
        self,
        phase: int,
        ask: Callable[..., Iterable[Message]],
        server_round: int,
        arrays: ArrayRecord,
        config: ConfigRecord,
        grid: Grid,
    ) -> list[Message]:
        nodes = self._partitions.nodes(grid)
        view = cast(Grid, View(grid, len(nodes)))
        # What clients need to know to repeat what they do.
        order = {"seed": self._seed, "round": server_round, "phase": phase, "run": self._run}
        with self._seeded(server_round, phase, _CONFIGURE):
            messages = ask(server_round, arrays, config, view)
            return self._partitions.addressed(messages, nodes, order)

    def summary(self) -> None:
        """The strategy's own."""
        self._strategy.summary()

    # --- A run ------------------------------------------------------------------------------------

    def start(
        self,
        grid: Grid,
        initial_arrays: ArrayRecord,
        num_rounds: int = 3,
        timeout: float = 3600,
        train_config: ConfigRecord | None = None,
        evaluate_config: ConfigRecord | None = None,
        evaluate_fn: Evaluate | None = None,
    ) -> Result:
        """As Flower's, and goes on from the newest whole checkpoint where there is one.

        Raises:
            OtherRunError: the folder holds a run of another seed, strategy, initial model or
                configuration of clients.
            ClientLostError: a client gave no result, as often as a round may be played.
        """
        train, evaluate = train_config or ConfigRecord(), evaluate_config or ConfigRecord()
        fresh = Progress(Result(initial_arrays), train, evaluate)
        self.summary()
        progress = self._begun(fresh, evaluate_fn)
        while progress.round < num_rounds:
            _LOG.info("[ROUND %s/%s]", progress.round + 1, num_rounds)
            progress = self._safely_played(grid, progress, timeout, evaluate_fn)
            self._save(progress)
        return progress.result

    def _begun(self, fresh: Progress, evaluate_fn: Evaluate | None) -> Progress:
        """Where a run is that begins, or goes on."""
        self._owner = {
            "seed": self._seed,
            "strategy": type(self._strategy).__name__,
            "initial model": digest(fresh.result.arrays),
            "configuration": fresh.configuration(),
        }
        found = checkpoints.newest(self._folder, self._owner) if self._folder else None
        progress = found or fresh
        self._kept.restore(progress.strategy)
        self._run = progress.run
        if found:
            _LOG.info("Going on from round %s", found.round)
        else:
            self._judge(fresh, evaluate_fn)
            self._save(fresh)
        return progress

    def _safely_played(
        self, grid: Grid, progress: Progress, timeout: float, evaluate_fn: Evaluate | None
    ) -> Progress:
        """The next round, from its beginning again where a client was lost."""
        for left in range(self._retries, -1, -1):
            try:
                return self._played(grid, progress.copy(), timeout, evaluate_fn)
            except ClientLostError as error:
                if not left:
                    raise
                _LOG.warning("%s; the round is played again", error)
                self._kept.restore(progress.strategy)
        raise AssertionError

    def _played(
        self, grid: Grid, progress: Progress, timeout: float, evaluate_fn: Evaluate | None
    ) -> Progress:
        """One round as Flower's ``start`` plays it."""
        progress.round += 1
        number, result = progress.round, progress.result
        asked = self.configure_train(number, result.arrays, progress.train_config, grid)
        replies = grid.send_and_receive(asked, timeout=timeout)
        arrays, metrics = self.aggregate_train(number, replies)
        if arrays is not None:
            result.arrays = arrays
        _noted(result.train_metrics_clientapp, number, metrics)
        asked = self.configure_evaluate(number, result.arrays, progress.evaluate_config, grid)
        replies = grid.send_and_receive(asked, timeout=timeout)
        _noted(result.evaluate_metrics_clientapp, number, self.aggregate_evaluate(number, replies))
        self._judge(progress, evaluate_fn)
        progress.strategy = self._kept.state()
        return progress

    def _judge(self, progress: Progress, evaluate_fn: Evaluate | None) -> None:
        """Evaluates the global model on the server."""
        if evaluate_fn is not None:
            with self._seeded(progress.round, SERVER, 0):
                metrics = evaluate_fn(progress.round, progress.result.arrays)
            _noted(progress.result.evaluate_metrics_serverapp, progress.round, metrics)

    def _save(self, progress: Progress) -> None:
        if self._folder:
            checkpoints.save(self._folder, progress, self._owner)

    def _seeded(self, server_round: int, phase: int, step: int) -> AbstractContextManager[None]:
        return seeded(self._seed, 0, server_round, phase, step)


def _noted(history: dict[int, MetricRecord], server_round: int, found: MetricRecord | None) -> None:
    """Adds a round's metrics to those of earlier ones."""
    if found is not None:
        _LOG.info("\t%s", found)
        history[server_round] = found
