"""Checks a configuration against what stands at its fields, one sentence for each wrong value.

A field of a schema is ``Annotated`` with its bounds (``annotated_types``), with a ``Literal`` of
its choices, and with a comment for whoever reads the configuration::

    robots: Annotated[int, Interval(ge=1, le=64), "K"] = 3
    access: Annotated[str, Literal["noma", "oma"]] = "noma"

What depends on more than one field is a rule: a function of the configuration that yields problems.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from numbers import Integral, Real
from types import NoneType
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Interval, Le, Lt

Problem = tuple[str, Any, str]
"""A key, the value it has, and what is allowed there."""

C = TypeVar("C")
_KINDS: dict[Any, tuple[str, Any]] = {
    bool: ("true or false", bool),
    int: ("a whole number", Integral),
    float: ("a number", Real),
    str: ("a word", str),
    list: ("a list", list),
}


def problems(
    config: C, rules: Iterable[Callable[[C], Iterable[Problem]]], above: str = ""
) -> list[Problem]:
    """What is wrong with a configuration: every wrong value, or what the first broken rule says.

    Args:
        config: a dataclass whose fields are annotated, or further dataclasses.
        rules: in an order in which each may count on those before it.
        above: what stands before the keys, such as ``env.``.
    """
    found = list(value_problems(config, above))
    for rule in rules:
        if found:
            return found
        found = list(rule(config))
    return found


def value_problems(config: Any, above: str = "") -> Iterator[Problem]:
    """Every value that its own field does not allow; arguments as ``problems``."""
    for item in fields(config):
        key, value = f"{above}{item.name}", getattr(config, item.name)
        if is_dataclass(value):
            yield from value_problems(value, f"{key}.")
        elif say := refused(value, hints_of(config.__class__)[item.name]):
            yield key, value, say


def refused(value: Any, hint: Any) -> str:
    """What is allowed where a value is not, in words; empty if it is allowed.

    Args:
        value: any.
        hint: the field's annotation.
    """
    kind, marks = _parts(hint)
    if kind is Any:
        return ""  # a rule looks at it
    null = NoneType in get_args(kind)
    if value is None and null:
        return ""
    kind = next((each for each in get_args(kind) if each is not NoneType), kind) if null else kind
    kind = get_origin(kind) or kind
    name, numbers = _KINDS[kind]
    ending = ", or null" if null else ""
    if not isinstance(value, numbers) or (isinstance(value, bool) and kind is not bool):
        return name + ending
    if kind is list:
        return _refused_items(value, hint, marks)
    if kind is float and not math.isfinite(value):
        return "a finite number" + ending
    for mark in marks:
        if get_origin(mark) is Literal and value not in get_args(mark):
            return one_of(get_args(mark)) + ending
    if all(compare(value, limit) for compare, limit, _ in _bounds(marks)):
        return ""
    return f"a number {_in_words(marks)}{ending}"


def one_of(names: Sequence[str]) -> str:
    """Choices in words."""
    return " or ".join(names) if len(names) == 2 else f"one of {', '.join(names)}"


def comments(schema: type) -> Mapping[str, str]:
    """What stands at each field for a reader, by its name; the choices where nothing does."""
    found = {}
    for name, hint in hints_of(schema).items():
        marks = _parts(hint)[1]
        choices = [one_of(get_args(mark)) for mark in marks if get_origin(mark) is Literal]
        found[name] = "; ".join([*choices, *(mark for mark in marks if isinstance(mark, str))])
    return found


@cache
def hints_of(schema: type) -> dict[str, Any]:
    """The annotation of each field, marks included."""
    return get_type_hints(schema, include_extras=True)


def _parts(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """A field's type and its marks."""
    if get_origin(hint) is Annotated:
        kind, *marks = get_args(hint)
        return kind, tuple(marks)
    return hint, ()


def _refused_items(value: list[Any], hint: Any, marks: tuple[Any, ...]) -> str:
    """The same for a list: its length, and its items where they have bounds."""
    least = next((mark.min_length for mark in marks if hasattr(mark, "min_length")), 0)
    [item] = get_args(_parts(hint)[0]) or (Any,)
    kind, bounds = _parts(item)
    wrong = bounds and any(refused(one, item) for one in value)
    if len(value) >= least and not wrong:
        return ""
    say = f"a list of {least} or more" if least else "a list"
    return f"{say}, each {_KINDS[kind][0]} {_in_words(bounds)}" if bounds else say


def _bounds(marks: Iterable[Any]) -> list[tuple[Callable[[Any, Any], bool], float, str]]:
    """How a value must compare with a limit, the limit, and how that is said."""
    found = []
    for mark in marks:
        for part in mark if isinstance(mark, Interval) else [mark]:
            if type(part) in _BOUNDS:
                name, compare, words = _BOUNDS[type(part)]
                limit = getattr(part, name)
                found.append((compare, limit, f"{words} {limit:.15g}"))
    return found


def _in_words(marks: Iterable[Any]) -> str:
    """Bounds such as "from 1 to 64" or "above 0"."""
    words = [say for _, _, say in _bounds(marks)]
    low, high = (_BOUNDS[kind][2] + " " for kind in (Ge, Le))
    if len(words) == 2 and words[0].startswith(low) and words[1].startswith(high):
        return f"from {words[0].removeprefix(low)} to {words[1].removeprefix(high)}"
    return " and ".join(words)


_BOUNDS: dict[type, tuple[str, Callable[[Any, Any], bool], str]] = {
    Ge: ("ge", operator.ge, "of at least"),
    Gt: ("gt", operator.gt, "above"),
    Le: ("le", operator.le, "at most"),
    Lt: ("lt", operator.lt, "below"),
}
