"""The world of RISFleet: physics on NumPy alone, and views for Gymnasium and PettingZoo.

Importing ``env`` registers ``risfleet/SingleRobot-v0`` with Gymnasium, now or as soon as somebody
imports Gymnasium, and loads nothing itself: robots and servers need the physics alone, and do not
wait for the views. The names below are imported when they are first used.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from numbers import Integral, Real
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from env.config import EnvConfig
    from env.parallel_env import RISFleetParallelEnv
    from env.single_robot import SingleRobotEnv
    from env.world import World

__all__ = ["EnvConfig", "RISFleetParallelEnv", "SingleRobotEnv", "World", "checked_config"]

SINGLE_ROBOT = "risfleet/SingleRobot-v0"
_HOMES = {
    "EnvConfig": "env.config",
    "RISFleetParallelEnv": "env.parallel_env",
    "SingleRobotEnv": "env.single_robot",
    "World": "env.world",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def checked_config(config: EnvConfig | Mapping[str, Any] | None = None) -> EnvConfig:
    """An environment's configuration, whole and checked.

    Args:
        config: a configuration; or the fields that differ from the defaults, nested as in
            ``{"robots": 2, "ris": {"side": 0}}``; or None, for the defaults.

    Returns:
        The configuration.

    Raises:
        ValueError: naming each key, the value it has and what is allowed there.
    """
    from env.config import EnvConfig, problems

    if isinstance(config, EnvConfig):
        whole = config
    else:
        whole = _replaced(EnvConfig(), {} if config is None else config, "env")
    found = problems(whole)
    if found:
        raise ValueError(
            "\n".join(f"{key}={value!r}: allowed is {say}" for key, value, say in found)
        )
    return whole


def _replaced(base: Any, values: Any, key: str) -> Any:
    """A dataclass with some fields replaced, whose types must be those of the old values."""
    if not isinstance(values, Mapping):
        raise ValueError(f"{key}={values!r}: allowed is a mapping of its fields")
    names = [field.name for field in fields(base)]
    changes = {}
    for name, value in values.items():
        if name not in names:
            raise ValueError(f"{key}.{name}={value!r}: allowed keys are {', '.join(names)}")
        old = getattr(base, name)
        if is_dataclass(old):
            nested = isinstance(value, type(old))
            changes[name] = value if nested else _replaced(old, value, f"{key}.{name}")
        else:
            changes[name] = _typed(value, old, f"{key}.{name}")
    return replace(base, **changes)


def _typed(value: Any, old: Any, key: str) -> Any:
    """The value, if it is of the old one's kind; sequences become lists all through."""
    if isinstance(old, list):
        kind, right = "a list", isinstance(value, Sequence) and not isinstance(value, str)
    elif isinstance(old, str):
        kind, right = "a word", isinstance(value, str)
    elif isinstance(old, bool):
        kind, right = "True or False", isinstance(value, bool)
    else:
        kind, number = ("a whole number", Integral) if isinstance(old, int) else ("a number", Real)
        right = isinstance(value, number) and not isinstance(value, bool)
    if not right:
        raise ValueError(f"{key}={value!r}: allowed is {kind}")
    return _as_list(value) if isinstance(old, list) else value


def _as_list(value: Any) -> Any:
    return [_as_list(item) for item in value] if isinstance(value, list | tuple) else value


def _register() -> None:
    """Registers the Gymnasium view; safe to call again."""
    import gymnasium

    if SINGLE_ROBOT not in gymnasium.registry:
        gymnasium.register(id=SINGLE_ROBOT, entry_point="env.single_robot:SingleRobotEnv")


class _OnceGymnasiumIsImported(MetaPathFinder):
    """Registers at the end of somebody's ``import gymnasium``, in whatever order that comes."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Gymnasium's own spec, with a loader that registers when it is done."""
        spec = PathFinder.find_spec(fullname, path, target) if fullname == "gymnasium" else None
        if spec is None or spec.loader is None:
            return None
        load = spec.loader.exec_module

        def load_and_register(module: ModuleType) -> None:
            load(module)
            _register()

        spec.loader.exec_module = load_and_register  # type: ignore[method-assign]
        return spec


if "gymnasium" in sys.modules:
    _register()
else:
    sys.meta_path.insert(0, _OnceGymnasiumIsImported())
