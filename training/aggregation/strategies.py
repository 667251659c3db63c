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
from training.aggregation.aggregator import Aggregator, Scope
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
        scope=Scope.ONLINE if online else Scope.PAIR,
        who=who,
        partial=partial,
        noise=functools.partial(stream, seed, Stream.PRIVACY) if noised else None,
    )


def _fedavg(config: StrategyConfig) -> FedAvg:
    return FedAvg()


def _fedprox(config: StrategyConfig) -> FedAvg:
    return FedProx(proximal_mu=config.proximal_mu)


def _krum(config: StrategyConfig) -> FedAvg:
    return Krum(num_malicious_nodes=config.malicious)


def _multikrum(config: StrategyConfig) -> FedAvg:
    return MultiKrum(num_malicious_nodes=config.malicious, num_nodes_to_select=config.selected)


def _bulyan(config: StrategyConfig) -> FedAvg:
    return Bulyan(num_malicious_nodes=config.malicious)


def _fedavgm(config: StrategyConfig) -> FedAvg:
    return FedAvgM(server_learning_rate=config.server_rate, server_momentum=config.momentum)


def _fedadam(config: StrategyConfig) -> FedAvg:
    return FedAdam(
        eta=config.server_rate, beta_1=config.beta_1, beta_2=config.beta_2, tau=config.tau
    )


def _fedmedian(config: StrategyConfig) -> FedAvg:
    return FedMedian()


def _fedtrimmedavg(config: StrategyConfig) -> FedAvg:
    return FedTrimmedAvg(beta=config.trim)


STRATEGIES: dict[str, Callable[[StrategyConfig], Strategy] | None] = {
    "fedavg": _fedavg,
    "fedavgm": _fedavgm,
    "fedadam": _fedadam,
    "fedmedian": _fedmedian,
    "fedtrimmedavg": _fedtrimmedavg,
    "fedprox": _fedprox,
    "gossip": None,
    "krum": _krum,
    "multikrum": _multikrum,
    "bulyan": _bulyan,
    "own": own_strategy,
    "visits": None,
    "none": None,
}

SERVER_OPTIMISERS = {"fedavgm", "fedadam"}
"""These are applied to the online weights alone, see ``Scope``."""
