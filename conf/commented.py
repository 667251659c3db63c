"""A configuration as people read it: YAML with what stands at each field as a comment."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import yaml  # type: ignore[import-untyped]

from conf.schema import Config
from env.validate import comments


def commented_yaml(config: Config) -> str:
    """The whole configuration; ``from_yaml`` reads it, too."""
    return "\n".join(_lines(config, "")) + "\n"


def _lines(config: Any, indent: str) -> Iterator[str]:
    said = comments(config.__class__)
    for item in fields(config):
        value = getattr(config, item.name)
        if is_dataclass(value):
            yield f"{indent}{item.name}:"
            yield from _lines(value, indent + "  ")
        else:
            comment = f" # {said[item.name]}" if said[item.name] else ""
            yield f"{indent}{item.name}: {_value(value)}{comment}"


def _value(value: Any) -> str:
    """A value on one line."""
    text: str = yaml.safe_dump(value, default_flow_style=True, width=float("inf"))
    return text.removesuffix("\n").removesuffix("\n...")
