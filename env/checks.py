"""A whole and checked configuration from the fields that differ from the defaults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

from env.config import EnvConfig
from env.config_checks import problems
from env.geometry import floor_plans
from env.validate import Problem, value_problems


def checked_config(config: EnvConfig | Mapping[str, Any] | None = None) -> EnvConfig:
    """An environment's configuration, whole and checked.

    Args:
        config: a configuration; or the fields that differ from the defaults, nested as in
            ``{"robots": 2, "ris": {"side": 0}}``, or from a floor plan, as in
            ``{"plan": "corridor", "robots": 2}``; or None, for the defaults.

    Raises:
        ValueError: naming each key, the value it has and what is allowed there.
    """
    if isinstance(config, EnvConfig):
        whole = config
    else:
        given = {} if config is None else config
        plan = given.get("plan", floor_plans.DEFAULT) if isinstance(given, Mapping) else None
        base = planned_config(plan) if isinstance(plan, str) else EnvConfig()
        whole = replaced(base, given, "env")
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
        plan: the name of a built-in plan, ``random:SEED``, or the path of a TOML file.

    Raises:
        ValueError: naming the plan, the key and what is allowed.
    """
    values = floor_plans.read(plan)
    above = f"env.plan={plan}: env"
    config: EnvConfig = replaced(EnvConfig(plan=plan), values, above)
    refuse(list(value_problems(config, f"{above}.")))
    return config


def replaced(base: Any, values: Any, key: str) -> Any:
    """A dataclass with some fields replaced, nested alike; sequences become lists.

    ``key`` is what the dataclass is called in a message.

    Raises:
        ValueError: there is no such field.
    """
    if not isinstance(values, Mapping):
        raise ValueError(f"{key}={values!r}: allowed is a mapping of its fields")
    names = [field.name for field in fields(base)]
    changes = {}
    for name, value in values.items():
        if name not in names:
            raise ValueError(f"{key}.{name}={value!r}: allowed keys are {', '.join(names)}")
        old = getattr(base, name)
        nested = is_dataclass(old) and not isinstance(value, type(old))
        changes[name] = replaced(old, value, f"{key}.{name}") if nested else _as_list(value)
    return replace(base, **changes)


def _as_list(value: Any) -> Any:
    return [_as_list(item) for item in value] if isinstance(value, list | tuple) else value
