"""The strategies that a run can choose, made from the group ``strategy``.

A strategy is one entry of ``STRATEGIES``, one of ``conf.strategy_checks`` and one file of
``conf/strategy``; its own keys are fields of ``StrategyConfig``.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

from flwr.serverapp.strategy import (
    Bulyan,
    FedAdam,
    FedAvg,
    FedAvgM,
    FedMedian,
    FedProx,
    FedTrimmedAvg,
    Krum,
    MultiKrum,
    Strategy,
)

from conf import StrategyConfig
from env.seeding import Stream, stream
from training.aggregation.aggregator import Aggregator
from training.aggregation.own import own_strategy
from training.aggregation.privacy import protected


def build_aggregator(
    config: StrategyConfig,
    robots: int,
    *,
    who: str = "robot",
    partial: bool = False,
    seed: int = 0,
    targets: bool = True,
) -> Aggregator | None:
    """Makes the aggregator of a run.

    Args:
        config: the group ``strategy``, checked.
        robots: K.
        who: what uploads, for messages.
        partial: whether fewer may upload.
        seed: the run's, of the noise of ``strategy.dp``.
        targets: whether anything comes of the target networks' result.

    Returns:
        A fresh aggregator, or None where no strategy of Flower's combines: ``none``, and what
        ``training.exchange.combining`` has beside it.
    """
    build = STRATEGIES[config.name]
    if build is None:
        return None
    noised = config.dp.name in ("central", "adaptive")
    online = config.name in SERVER_OPTIMISERS or config.scope == "online"
    online |= noised and not targets  # or clipping would count online networks twice
    return Aggregator(
        protected(build(config), config.dp, robots),
        robots,
        online=online,
        who=who,
        partial=partial,
        noise=functools.partial(stream, seed, Stream.PRIVACY) if noised else None,
    )


STRATEGIES: dict[str, Callable[[StrategyConfig], Strategy] | None] = {
    "fedavg": lambda _: FedAvg(),
    "fedavgm": lambda c: FedAvgM(server_learning_rate=c.server_rate, server_momentum=c.momentum),
    "fedadam": lambda c: FedAdam(eta=c.server_rate, beta_1=c.beta_1, beta_2=c.beta_2, tau=c.tau),
    "fedmedian": lambda _: FedMedian(),
    "fedtrimmedavg": lambda c: FedTrimmedAvg(beta=c.trim),
    "fedprox": lambda c: FedProx(proximal_mu=c.proximal_mu),
    "gossip": None,
    "krum": lambda c: Krum(num_malicious_nodes=c.malicious),
    "multikrum": lambda c: MultiKrum(
        num_malicious_nodes=c.malicious, num_nodes_to_select=c.selected
    ),
    "bulyan": lambda c: Bulyan(num_malicious_nodes=c.malicious),
    "own": own_strategy,
    "visits": None,
    "none": None,
}
"""Makes each of Flower's from the group ``strategy``."""

SERVER_OPTIMISERS = {"fedavgm", "fedadam"}
"""These are applied to the online weights alone."""
