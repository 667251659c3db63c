"""Keys that were taken out: configurations of older runs and weights hold them still."""

from __future__ import annotations

from omegaconf import DictConfig

from conf.errors import ConfigError

REMOVED = {
    "agent.factored": (False, "0daecad"),
    "agent.dueling": (False, "2a18898"),
    "agent.n_step": (1, "2a18898"),
    "agent.priority": ({"alpha": 0.0, "beta": 0.4}, "2a18898"),
}
"""For each key the value that means "off", and the last commit with it."""


def drop_removed(node: DictConfig) -> None:
    """Takes out of a stored configuration the keys that were taken out of the schema.

    Raises:
        ConfigError: one of them is not off.
    """
    for key, (off, _) in REMOVED.items():
        above, _, name = key.rpartition(".")
        group = node.get(above)
        if isinstance(group, DictConfig) and name in group and group.pop(name) != off:
            check_removed(key)


def check_removed(key: str) -> None:
    """Refuses a key that was taken out, or one of its group's.

    Raises:
        ConfigError: it was; the sentence names the last commit with it.
    """
    for gone, (_, commit) in REMOVED.items():
        if key == gone or key.startswith(f"{gone}."):
            raise ConfigError(f"{gone} was taken out: the last commit with it is {commit}.")
