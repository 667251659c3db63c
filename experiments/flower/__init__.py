"""Launchers of Flower's runtimes: what they start ends with them.

Names are looked up when they are wanted: a watchdog needs a module of this package, and neither
the time nor the memory that torch takes, which others import.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from experiments.flower.connection import Connection
    from experiments.flower.control import RunState, Status
    from experiments.flower.engine import SimulationSuperLink
    from experiments.flower.environment import FlowerError, ProcessLostError, UnansweredError
    from experiments.flower.federation import Federation
    from experiments.flower.manifest import Components

__all__ = [
    "Components",
    "Connection",
    "Federation",
    "FlowerError",
    "ProcessLostError",
    "RunState",
    "SimulationSuperLink",
    "Status",
    "UnansweredError",
]

_MODULES = {
    "Components": "manifest",
    "Connection": "connection",
    "Federation": "federation",
    "FlowerError": "environment",
    "ProcessLostError": "environment",
    "RunState": "control",
    "SimulationSuperLink": "engine",
    "Status": "control",
    "UnansweredError": "environment",
}


def __getattr__(name: str) -> Any:
    """One of the names above, from its module."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
