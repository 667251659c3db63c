"""What stands at a field is checked there, and each wrong value is said in one sentence."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from annotated_types import Ge, Gt, Interval, Lt, MinLen

from env.validate import comments, problems, refused, value_problems


@dataclass(frozen=True)
class Inner:
    share: Annotated[float, Interval(ge=0, lt=1), "of all"] = 0.5


@dataclass(frozen=True)
class Outer:
    count: Annotated[int, Interval(ge=1, le=3)] = 2
    kind: Annotated[str, Literal["a", "b", "c"], "which"] = "a"
    inner: Inner = field(default_factory=Inner)


@pytest.mark.parametrize(
    ("value", "hint", "allowed"),
    [
        (1, int, ""),
        (np.int64(1), int, ""),
        (True, int, "a whole number"),
        (1.5, int, "a whole number"),
        ("1", float, "a number"),
        (1, float, ""),
        (float("inf"), float, "a finite number"),
        (float("nan"), float | None, "a finite number, or null"),
        (None, float | None, ""),
        (None, float, "a number"),
        (1, bool, "true or false"),
        (3, str, "a word"),
        (0, Annotated[int, Ge(1)], "a number of at least 1"),
        (0, Annotated[int | None, Ge(1)], "a number of at least 1, or null"),
        (None, Annotated[int | None, Ge(1)], ""),
        (0.0, Annotated[float, Gt(0)], "a number above 0"),
        (2, Annotated[float, Gt(0), Lt(2)], "a number above 0 and below 2"),
        (4, Annotated[int, Interval(ge=1, le=3)], "a number from 1 to 3"),
        (1e9, Annotated[float, Interval(ge=0, le=1_000_000)], "a number from 0 to 1000000"),
        ("x", Annotated[str, Literal["a", "b"]], "a or b"),
        ("x", Annotated[str, Literal["a", "b", "c"]], "one of a, b, c"),
        ("a", list[Any], "a list"),
        ([], list[Any], ""),
        ([], Annotated[list[int], MinLen(1)], "a list of 1 or more"),
        ([1, 0], list[Annotated[int, Ge(1)]], "a list, each a whole number of at least 1"),
        ([1.0, float("inf")], list[float], ""),
    ],
)
def test_a_value_is_allowed_or_what_is_allowed_is_said(value, hint, allowed):
    assert refused(value, hint) == allowed


def test_every_wrong_value_is_found_however_deep():
    wrong = Outer(count=0, kind="z", inner=Inner(share=1.0))
    assert [(key, value) for key, value, _ in value_problems(wrong, "x.")] == [
        ("x.count", 0),
        ("x.kind", "z"),
        ("x.inner.share", 1.0),
    ]


def test_a_rule_may_count_on_values_and_on_the_rules_before_it():
    asked = []

    def first(config):
        asked.append("first")
        return [("count", config.count, "less")] if config.count == 3 else []

    def second(config):
        asked.append("second")
        yield "kind", config.kind, "another"

    assert problems(Outer(count=9), (first, second)) == [("count", 9, "a number from 1 to 3")]
    assert asked == []
    assert problems(Outer(count=3), (first, second)) == [("count", 3, "less")]
    assert asked == ["first"]
    assert problems(Outer(), (first, second)) == [("kind", "a", "another")]


def test_comments_are_choices_and_what_stands_there():
    assert comments(Outer) == {"count": "", "kind": "one of a, b, c; which", "inner": ""}
    assert comments(Inner) == {"share": "of all"}
