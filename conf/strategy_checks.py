"""The rules of the group ``strategy``: which keys each strategy reads, and what it allows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from conf.errors import ConfigError, shown
from conf.exchange_schema import PrivacyConfig
from conf.python_values import value_text
from conf.schema import StrategyConfig, changed
from env.validate import Problem

KEYS: dict[str, frozenset[str]] = {
    "fedavg": frozenset(),
    "fedavgm": frozenset({"server_rate", "momentum"}),
    "fedadam": frozenset({"server_rate", "beta_1", "beta_2", "tau"}),
    "fedmedian": frozenset(),
    "fedtrimmedavg": frozenset({"trim"}),
    "fedprox": frozenset({"proximal_mu"}),
    "gossip": frozenset({"graph", "degree"}),
    "krum": frozenset({"malicious"}),
    "multikrum": frozenset({"malicious", "selected"}),
    "bulyan": frozenset({"malicious"}),
    "own": frozenset({"target", "options", "scope"}),
    "visits": frozenset(),
    "none": frozenset(),
}
"""The keys that each strategy reads, ``name`` and ``dp`` aside."""

PRIVACY_KEYS: dict[str, frozenset[str]] = {
    "none": frozenset(),
    "central": frozenset({"clip", "noise", "delta"}),
    "adaptive": frozenset({"clip", "noise", "delta", "quantile", "clip_rate"}),
    "local": frozenset({"clip", "noise", "delta"}),
}
"""The same of each way to differential privacy."""

MEANS = ("fedavg", "fedprox")
"""Strategies whose result moves by at most C / K where one of K steps of norm C is taken out."""

FULL_NUMBER = frozenset({"krum", "multikrum", "bulyan", "fedtrimmedavg"})
"""Those that leave out so many of the uploads that there are, so that none may miss."""


def problems(config: StrategyConfig, count: int, counted: str) -> Iterator[Problem]:
    """What is wrong with a strategy of so many uploads, as the key ``counted`` says."""
    if config.name not in KEYS:
        yield "strategy.name", config.name, f"one of {', '.join(KEYS)}"
        return
    yield from _unread(config, KEYS, "strategy")
    yield from _unread(config.dp, PRIVACY_KEYS, "strategy/dp")
    yield from _privacy(config)
    if config.name in _RULES:
        yield from _RULES[config.name](config, count, counted)


def _unread(
    config: StrategyConfig | PrivacyConfig, readers: Mapping[str, frozenset[str]], group: str
) -> Iterator[Problem]:
    """Keys that are set and that the choice of a group does not read."""
    for key, value, default in changed(config):
        if key in {"name", "dp", *readers[config.name]}:
            continue
        names = " or ".join(name for name, keys in readers.items() if key in keys)
        allowed = f"{shown(default)} with {group}={config.name}: only {names} reads it"
        yield f"{group.replace('/', '.')}.{key}", value, allowed


def _privacy(config: StrategyConfig) -> Iterator[Problem]:
    """Noise on the result is measured for a mean; noise on uploads suits whatever averages them."""
    if config.dp.name in ("central", "adaptive") and config.name not in MEANS:
        allowed = f"none or local with strategy={config.name}: noise is measured for a plain mean"
        yield "strategy.dp.name", config.dp.name, f"{allowed}, {' or '.join(MEANS)}"
    if config.dp.name == "local" and config.name == "none":
        yield "strategy.dp.name", "local", "none with strategy=none: nothing is averaged"


def _fedprox(config: StrategyConfig, count: int, counted: str) -> Iterator[Problem]:
    if not config.proximal_mu > 0:
        allowed = "a number above 0 (without the proximal term it is strategy=fedavg)"
        yield "strategy.proximal_mu", config.proximal_mu, allowed


def _fedtrimmedavg(config: StrategyConfig, count: int, counted: str) -> Iterator[Problem]:
    """Flower cuts int(beta K) uploads off at either end; without one it is the mean."""
    if int(config.trim * count) == 0:
        allowed = f"at least 1 / {counted}={count}, which cuts one upload off at either end"
        yield "strategy.trim", config.trim, allowed


def _gossip(config: StrategyConfig, count: int, counted: str) -> Iterator[Problem]:
    """Whether there are others to hear, and what only a random graph has."""
    if count < 2:
        yield "strategy.name", config.name, f"{counted} of at least 2, not {count}"
    elif config.graph != "random" and config.degree != StrategyConfig().degree:
        say = f"{StrategyConfig().degree} with strategy.graph={config.graph}: only random reads it"
        yield "strategy.degree", config.degree, say
    elif config.degree >= count:
        yield "strategy.degree", config.degree, f"from 1 to {count - 1} with {counted}={count}"


def _krum(config: StrategyConfig, count: int, counted: str) -> Iterator[Problem]:
    """Whether K is large enough for f, and of multikrum no more picked than may be honest.

    Krum needs K >= 2f + 3 (Blanchard et al., 2017, Proposition 2), Bulyan K >= 4f + 3 (El Mhamdi
    et al., 2018, section 4), which Flower's skips otherwise.
    """
    rule, times = ("Bulyan", 4) if config.name == "bulyan" else ("Krum", 2)
    most = (count - 3) // times
    need = f"{rule} needs {counted}={count} to be at least {times} malicious + 3"
    if most < 0:
        yield "strategy.name", config.name, f"{counted} of at least 3, not {count}"
    elif config.malicious > most:
        yield "strategy.malicious", config.malicious, f"from 0 to {most}: {need}"
    if config.name == "multikrum" and config.selected > count - config.malicious:
        allowed = f"from 1 to {counted} - malicious = {count - config.malicious}"
        yield "strategy.selected", config.selected, allowed


def _fedadam(config: StrategyConfig, count: int, counted: str) -> Iterator[Problem]:
    """What Reddi et al., 2021, Algorithm 2 allows."""
    if not config.tau > 0:
        allowed = "a number above 0: the root of the squares is 0 where no robot moves a weight"
        yield "strategy.tau", config.tau, allowed


def _own(config: StrategyConfig, count: int, counted: str) -> Iterator[Problem]:
    """Whether it is named; whether it is there is found where it is made."""
    if config.target is None:
        yield "strategy.target", None, "an installed strategy's name, or package:Class"
    key, options = "strategy.options", {} if config.options is None else config.options
    try:
        value_text(key, options)
        wrong = not isinstance(options, dict)
    except ConfigError:
        wrong = True
    if wrong:
        yield key, options, "a mapping from words, such as {beta: 0.2}, or null"


_RULES: dict[str, Callable[[StrategyConfig, int, str], Iterator[Problem]]] = {
    "fedadam": _fedadam,
    "fedprox": _fedprox,
    "fedtrimmedavg": _fedtrimmedavg,
    "gossip": _gossip,
    "krum": _krum,
    "multikrum": _krum,
    "bulyan": _krum,
    "own": _own,
}
