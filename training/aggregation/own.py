"""A Flower ``Strategy`` of the user's own, found by name (docs/extending.md).

Only the server makes it, so a client's machine need not have it.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint
from typing import Any

import numpy as np
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
    """A fresh strategy of the group ``strategy`` with ``name=own``.

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


def try_out(config: StrategyConfig, count: int, *, in_this_process: bool) -> None:
    """Lets a strategy average a few weights, of so many uploads, once.

    Names may be registered where the run is played ``in_this_process``.

    Raises:
        PluginError: see ``own_strategy``; or it fails.
    """
    from training.aggregation.strategies import build_aggregator  # which knows this module

    target = str(config.target)
    if not in_this_process and _STRATEGIES.is_registered(target):
        say = "with runtime=local a name that is registered, elsewhere one that is installed"
        raise PluginError(KEY, target, say)
    weights = np.zeros((count, 2, 3), dtype=np.float32)
    try:
        aggregator = build_aggregator(config, count)
        assert aggregator is not None
        aggregator.aggregate(1, weights[0], weights)
        aggregator.state()
    except PluginError:
        raise
    except Exception as error:
        say = f"a strategy that averages {count} networks ({type(error).__name__}: {error})"
        raise PluginError(KEY, target, say) from error


def _class_at(target: str) -> Callable[..., Any]:
    """What ``package:Class`` names, in what is installed."""
    if not EntryPoint.pattern.fullmatch(target):
        raise PluginError(KEY, target, "package:Class")
    try:
        found = EntryPoint(target, target, GROUP).load()
    except Exception as error:
        say = f"package:Class of something installed ({type(error).__name__}: {error})"
        raise PluginError(KEY, target, say) from error
    if not (isinstance(found, type) and issubclass(found, Strategy)):
        raise PluginError(KEY, target, "a class of Flower's Strategy")  # others are not called
    return found
