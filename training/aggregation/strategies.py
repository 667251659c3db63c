"""The strategies that a run can choose: schema, checks and construction of the group ``strategy``.

A strategy is one entry of ``STRATEGIES`` and one file of ``conf/strategy``; its own keys are fields
of ``StrategyConfig``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

from flwr.serverapp.strategy import FedAdam, FedAvg, FedAvgM, FedMedian, FedProx, Krum

from conf import StrategyConfig
from env.validate import Problem
from training.aggregation.aggregator import Aggregator, Scope


def _no_problems(config: StrategyConfig, robots: int) -> list[Problem]:
    return []


@dataclass(frozen=True)
class _Entry:
    """One strategy: how it is made, what it is applied to, which keys it reads and allows."""

    build: Callable[[StrategyConfig], FedAvg] | None
    scope: Scope = Scope.PAIR
    keys: frozenset[str] = frozenset()
    check: Callable[[StrategyConfig, int], list[Problem]] = _no_problems


def problems(config: StrategyConfig, robots: int) -> list[Problem]:
    """Lists what is wrong with a configuration: keys, their values, and what is allowed.

    Args:
        config: the group ``strategy``.
        robots: K.
    """
    entry = STRATEGIES.get(config.name)
    if entry is None:
        return [("strategy.name", config.name, f"one of {', '.join(STRATEGIES)}")]
    found: list[Problem] = []
    for field in fields(config):
        value = getattr(config, field.name)
        if field.name in {"name", *entry.keys} or value == field.default:
            continue
        readers = " or ".join(
            name for name, other in STRATEGIES.items() if field.name in other.keys
        )
        allowed = f"{field.default} with strategy={config.name}: only {readers} reads it"
        found.append((f"strategy.{field.name}", value, allowed))
    return found + entry.check(config, robots)


def build_aggregator(config: StrategyConfig, robots: int) -> Aggregator | None:
    """Makes the aggregator of a run.

    Args:
        config: the group ``strategy``, free of ``problems``.
        robots: K.

    Returns:
        A fresh aggregator, or None for ``none``, where each robot keeps its own weights.
    """
    entry = STRATEGIES[config.name]
    if entry.build is None:
        return None
    return Aggregator(entry.build(config), robots, scope=entry.scope)


def _fedavg(config: StrategyConfig) -> FedAvg:
    return FedAvg()


def _fedprox(config: StrategyConfig) -> FedAvg:
    return FedProx(proximal_mu=config.proximal_mu)


def _krum(config: StrategyConfig) -> FedAvg:
    return Krum(num_malicious_nodes=config.malicious)


def _fedavgm(config: StrategyConfig) -> FedAvg:
    return FedAvgM(server_learning_rate=config.server_rate, server_momentum=config.momentum)


def _fedadam(config: StrategyConfig) -> FedAvg:
    return FedAdam(
        eta=config.server_rate, beta_1=config.beta_1, beta_2=config.beta_2, tau=config.tau
    )


def _fedmedian(config: StrategyConfig) -> FedAvg:
    return FedMedian()


def _fedprox_problems(config: StrategyConfig, robots: int) -> list[Problem]:
    if config.proximal_mu > 0:
        return []
    allowed = "a number above 0 (without the proximal term it is strategy=fedavg)"
    return [("strategy.proximal_mu", config.proximal_mu, allowed)]


def _krum_problems(config: StrategyConfig, robots: int) -> list[Problem]:
    """Krum tolerates f of K robots where K >= 2f + 3 (Blanchard et al., 2017, Proposition 2)."""
    most = (robots - 3) // 2
    if most < 0:
        return [("strategy.name", config.name, f"env.robots of at least 3, not {robots}")]
    if config.malicious <= most:
        return []
    allowed = f"from 0 to {most}: Krum needs env.robots={robots} to be at least 2 malicious + 3"
    return [("strategy.malicious", config.malicious, allowed)]


def _fedadam_problems(config: StrategyConfig, robots: int) -> list[Problem]:
    """What Reddi et al., 2021, Algorithm 2 allows."""
    if config.tau > 0:
        return []
    allowed = "a number above 0: the root of the squares is 0 where no robot moves a weight"
    return [("strategy.tau", config.tau, allowed)]


STRATEGIES: dict[str, _Entry] = {
    "fedavg": _Entry(_fedavg),
    "fedavgm": _Entry(_fedavgm, Scope.ONLINE, frozenset({"server_rate", "momentum"})),
    "fedadam": _Entry(
        _fedadam,
        Scope.ONLINE,
        frozenset({"server_rate", "beta_1", "beta_2", "tau"}),
        _fedadam_problems,
    ),
    "fedmedian": _Entry(_fedmedian),
    "fedprox": _Entry(_fedprox, keys=frozenset({"proximal_mu"}), check=_fedprox_problems),
    "krum": _Entry(_krum, keys=frozenset({"malicious"}), check=_krum_problems),
    "none": _Entry(None),
}
