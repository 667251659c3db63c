"""Keys that were taken out: configurations of older runs and weights hold them still."""

from __future__ import annotations

from typing import Any

from conf.errors import ConfigError

REMOVED = {
    "agent.factored": (False, "0daecad"),
    "agent.dueling": (False, "2a18898"),
    "agent.n_step": (1, "2a18898"),
    "agent.priority": ({"alpha": 0.0}, "2a18898"),
}
"""For each key the value that means "off", or that of a key in its group, and the last commit."""


def drop_removed(values: Any) -> None:
    """Takes out of a stored configuration the keys that were taken out of the schema.

    Args:
        values: as it was stored: groups are dicts, if it is as it should be.

    Raises:
        ConfigError: one of them is not off.
    """
    for key, (off, _) in REMOVED.items():
        above, _, name = key.rpartition(".")
        group = values.get(above)
        if isinstance(group, dict) and name in group and not _is(group.pop(name), off):
            check_removed(key)


def _is(value: Any, off: Any) -> bool:
    if isinstance(off, dict) and isinstance(value, dict):
        return all(value.get(key, each) == each for key, each in off.items())
    return bool(value == off)


def check_removed(key: str) -> None:
    """Refuses a key that was taken out, or one of its group's.

    Raises:
        ConfigError: it was; the sentence names the last commit with it.
    """
    for gone, (_, commit) in REMOVED.items():
        if key == gone or key.startswith(f"{gone}."):
            raise ConfigError(f"{gone} was taken out: the last commit with it is {commit}.")
