"""A Flower ``Strategy`` of the user's own, found by name (docs/extending.md).

Only the server makes it, so a client's machine need not have it.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint
from typing import Any

from flwr.serverapp.strategy import Strategy

from conf import StrategyConfig
from env.plugins import Models, PluginError

KEY, GROUP = "strategy.target", "risfleet.strategies"
_STRATEGIES = Models(KEY, (), GROUP)


def register_strategy(name: str, make: Callable[..., Strategy]) -> None:
    """Makes a strategy known in this process, as ``strategy=own strategy.target=NAME``.

    Args:
        name: letters, digits, ``_``, ``-`` and ``.``; again the same name replaces it.
        make: a class, or a function, that takes ``strategy.options`` and gives a Flower strategy.

    Raises:
        ValueError: that is no such name, or nothing to call.
    """
    _STRATEGIES.register(name, make)


def own_strategy(config: StrategyConfig) -> Strategy:
    """A fresh strategy.

    Args:
        config: the group ``strategy``, with ``name=own``.

    Raises:
        PluginError: it is not there, does not load, does not take the options, or is no strategy.
    """
    target = str(config.target)
    make = _class_at(target) if ":" in target else _STRATEGIES.find(target)
    assert make is not None  # no name is ours
    try:
        strategy = make(**(config.options or {}))
    except Exception as error:
        say = f"a strategy that takes strategy.options={config.options} ({error})"
        raise PluginError(KEY, target, say) from error
    if not isinstance(strategy, Strategy):
        say = f"one of Flower's Strategy, and not {type(strategy).__name__}"
        raise PluginError(KEY, target, say)
    return strategy


def _class_at(target: str) -> Callable[..., Any]:
    """What ``package:Class`` names, in what is installed."""
    try:
        found = EntryPoint(target, target, GROUP).load()
    except Exception as error:
        say = f"package:Class of something installed ({type(error).__name__}: {error})"
        raise PluginError(KEY, target, say) from error
    if not (isinstance(found, type) and issubclass(found, Strategy)):
        raise PluginError(KEY, target, "a class of Flower's Strategy")  # others are not called
    return found
