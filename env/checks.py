"""A whole and checked configuration from the fields that differ from the defaults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from numbers import Integral, Real
from typing import Any

from env import floor_plans
from env.config import EnvConfig, Problem
from env.config_checks import problems


def checked_config(config: EnvConfig | Mapping[str, Any] | None = None) -> EnvConfig:
    """An environment's configuration, whole and checked.

    Args:
        config: a configuration; or the fields that differ from the defaults, nested as in
            ``{"robots": 2, "ris": {"side": 0}}``, or from a floor plan, as in
            ``{"plan": "corridor", "robots": 2}``; or None, for the defaults.

    Returns:
        The configuration.

    Raises:
        ValueError: naming each key, the value it has and what is allowed there.
    """
    if isinstance(config, EnvConfig):
        whole = config
    else:
        given = {} if config is None else config
        plan = given.get("plan", floor_plans.DEFAULT) if isinstance(given, Mapping) else None
        base = planned_config(plan) if isinstance(plan, str) else EnvConfig()
        whole = _replaced(base, given, "env")
    refuse(problems(whole))
    return whole


def refuse(found: Sequence[Problem]) -> None:
    """Raises a ``ValueError`` that names each key, its value and what is allowed, if any is."""
    if found:
        raise ValueError(
            "\n".join(f"{key}={value!r}: allowed is {say}" for key, value, say in found)
        )


def planned_config(plan: str) -> EnvConfig:
    """The defaults with a floor plan's geometry, its types checked and its values not yet.

    Args:
        plan: the name of a built-in plan, or the path of a TOML file.

    Raises:
        ValueError: naming the plan, the key and what is allowed.
    """
    values = floor_plans.read(plan)
    config: EnvConfig = _replaced(EnvConfig(plan=plan), values, f"env.plan={plan}: env")
    return config


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
