"""Flower apps whose runs repeat: the same bits from the same seed, and after a crash.

| name | what it is |
|---|---|
| `Repeatable` | wraps any Flower strategy: order, sampling, checkpoints, exact resume |
| `client_app` | a ClientApp whose clients draw repeatably and keep their state |
| `generator` | a client's own generator for the message in hand |
| `digest` | 64 digits that say whether two models are the same to the bit |
| `seeded` | global generators seeded for a while, and put back |
| `LocalGrid` | an app's clients in this process, for tests |
| `ClientLostError`, `OtherRunError` | a client that gave nothing; a folder with another run |

`python -m repeatable kill APP` kills real runs of an app by a seeded schedule and compares digests.
Flower is imported when a name is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from repeatable.checkpoints import OtherRunError
    from repeatable.client import client_app, generator
    from repeatable.isolation import seeded
    from repeatable.local import LocalGrid
    from repeatable.partitions import ClientLostError
    from repeatable.records import digest
    from repeatable.strategy import Repeatable

__all__ = [
    "ClientLostError",
    "LocalGrid",
    "OtherRunError",
    "Repeatable",
    "client_app",
    "digest",
    "generator",
    "seeded",
]

_HOMES = {
    "ClientLostError": "partitions",
    "LocalGrid": "local",
    "OtherRunError": "checkpoints",
    "Repeatable": "strategy",
    "client_app": "client",
    "digest": "records",
    "generator": "client",
    "seeded": "isolation",
}


def __getattr__(name: str) -> Any:
    """One of the names above, from its module."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
