"""The rules of the group ``strategy``: which keys each strategy reads, and what it allows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields

from conf.errors import ConfigError, shown
from conf.python_values import value_text
from conf.schema import Config, StrategyConfig
from env.validate import Problem

KEYS: dict[str, frozenset[str]] = {
    "fedavg": frozenset(),
    "fedavgm": frozenset({"server_rate", "momentum"}),
    "fedadam": frozenset({"server_rate", "beta_1", "beta_2", "tau"}),
    "fedmedian": frozenset(),
    "fedtrimmedavg": frozenset({"trim"}),
    "fedprox": frozenset({"proximal_mu"}),
    "krum": frozenset({"malicious"}),
    "multikrum": frozenset({"malicious", "selected"}),
    "bulyan": frozenset({"malicious"}),
    "own": frozenset({"target", "options", "scope"}),
    "none": frozenset(),
}
"""The keys that each strategy reads, ``name`` aside."""


FULL_NUMBER = frozenset({"krum", "multikrum", "bulyan"})
"""Those whose bound on hostile uploads is one on how many there are, so that none may miss."""


def rules(config: Config) -> Iterator[Problem]:
    """The rules, of a whole configuration."""
    return problems(config.strategy, config.env.robots)


def problems(config: StrategyConfig, count: int, counted: str = "env.robots") -> Iterator[Problem]:
    """What is wrong with a configuration: keys, their values, and what is allowed.

    Args:
        config: the group ``strategy``.
        count: how many are averaged.
        counted: the key that says so.
    """
    if config.name not in KEYS:
        yield "strategy.name", config.name, f"one of {', '.join(KEYS)}"
        return
    for field in fields(config):
        value = getattr(config, field.name)
        default = getattr(StrategyConfig(), field.name)
        if field.name in {"name", *KEYS[config.name]} or value == default:
            continue
        readers = " or ".join(name for name, keys in KEYS.items() if field.name in keys)
        allowed = f"{shown(default)} with strategy={config.name}: only {readers} reads it"
        yield f"strategy.{field.name}", value, allowed
    if config.name in _RULES:
        yield from _RULES[config.name](config, count, counted)


def _fedprox(config: StrategyConfig, count: int, counted: str) -> Iterator[Problem]:
    if not config.proximal_mu > 0:
        allowed = "a number above 0 (without the proximal term it is strategy=fedavg)"
        yield "strategy.proximal_mu", config.proximal_mu, allowed


def _krum(config: StrategyConfig, count: int, counted: str) -> Iterator[Problem]:
    """Krum tolerates f of K robots where K >= 2f + 3 (Blanchard et al., 2017, Proposition 2)."""
    most = (count - 3) // 2
    if most < 0:
        yield "strategy.name", config.name, f"{counted} of at least 3, not {count}"
    elif config.malicious > most:
        allowed = f"from 0 to {most}: Krum needs {counted}={count} to be at least 2 malicious + 3"
        yield "strategy.malicious", config.malicious, allowed


def _multikrum(config: StrategyConfig, count: int, counted: str) -> Iterator[Problem]:
    """Krum's bound, and no more uploads than may be honest."""
    yield from _krum(config, count, counted)
    if config.selected > count - config.malicious:
        allowed = f"from 1 to {counted} - malicious = {count - config.malicious}"
        yield "strategy.selected", config.selected, allowed


def _bulyan(config: StrategyConfig, count: int, counted: str) -> Iterator[Problem]:
    """Bulyan needs K >= 4f + 3 (El Mhamdi et al., 2018, section 4); Flower's skips otherwise."""
    most = (count - 3) // 4
    if most < 0:
        yield "strategy.name", config.name, f"{counted} of at least 3, not {count}"
    elif config.malicious > most:
        allowed = f"from 0 to {most}: Bulyan needs {counted}={count} to be at least 4 malicious + 3"
        yield "strategy.malicious", config.malicious, allowed


def _fedadam(config: StrategyConfig, count: int, counted: str) -> Iterator[Problem]:
    """What Reddi et al., 2021, Algorithm 2 allows."""
    if not config.tau > 0:
        allowed = "a number above 0: the root of the squares is 0 where no robot moves a weight"
        yield "strategy.tau", config.tau, allowed


def _own(config: StrategyConfig, count: int, counted: str) -> Iterator[Problem]:
    """Whether it is named; whether it is there is found where it is made."""
    if config.target is None:
        yield "strategy.target", None, "an installed strategy's name, or package:Class"
    options = {} if config.options is None else config.options
    allowed = "a mapping from words, such as {beta: 0.2}, or null"
    if not isinstance(options, dict):
        yield "strategy.options", options, allowed
        return
    try:
        value_text("strategy.options", options)
    except ConfigError:
        yield "strategy.options", options, allowed


_RULES: dict[str, Callable[[StrategyConfig, int, str], Iterator[Problem]]] = {
    "fedadam": _fedadam,
    "fedprox": _fedprox,
    "krum": _krum,
    "multikrum": _multikrum,
    "bulyan": _bulyan,
    "own": _own,
}
