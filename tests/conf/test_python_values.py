"""Overrides as Python writes them mean what the command line's texts mean."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conf import ConfigError, compose
from conf.overrides import combinations, parse
from conf.python_values import grid_texts, override_texts


@pytest.mark.parametrize(
    ("values", "texts"),
    [
        ({"env.robots": 4}, ["env.robots=4"]),
        ({"env.robots": np.int64(4)}, ["env.robots=4"]),
        ({"experiment": "best"}, ["experiment=best"]),
        ({"env.state.way": "on"}, ["env.state.way='on'"]),
        ({"agent.double": True}, ["agent.double=true"]),
        ({"train.max_ticks": None}, ["train.max_ticks=null"]),
        ({"agent.learning_rate": 1e-4}, ["agent.learning_rate=0.0001"]),
        ({"agent.hidden": (32, 16)}, ["agent.hidden=[32,16]"]),
        (
            {"env.tasks.destinations_m": np.array([[1.25, 2.25], [10.25, 2.25], [20.25, 2.25]])},
            ["env.tasks.destinations_m=[[1.25,2.25],[10.25,2.25],[20.25,2.25]]"],
        ),
        ({"run.dir": Path("my, runs") / "it's"}, [r"run.dir=my, runs/it's"]),
        ("seed=3", ["seed=3"]),
        (("seed=3",), ["seed=3"]),
    ],
)
def test_values_of_python_mean_what_texts_mean(values: Any, texts: list[str]) -> None:
    written, read = (parse(each) for each in (override_texts(values), texts))
    assert [(o.key_or_group, o.value()) for o in written] == [
        (o.key_or_group, o.value()) for o in read
    ]


@given(st.text(st.characters(exclude_categories=["Cs"], exclude_characters="$\0"), min_size=1))
def test_any_text_comes_through_as_it_is(text: str) -> None:
    (override,) = parse(override_texts({"env.reward.model": text}))
    assert override.value() == text


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"seed": object}, "seed=<class 'object'>: allowed is None, a truth value, a number"),
        ([3], '3: allowed is a text such as "env.robots=4".'),
        ({"env.robots": [2, 3]}, "env.robots=[2,3]: allowed is a whole number."),
        ({"env.robots": "four"}, "env.robots=four: allowed is a whole number."),
    ],
)
def test_what_no_key_can_have_is_refused_in_a_sentence(wrong: Any, sentence: str) -> None:
    with pytest.raises(ConfigError) as refused:
        compose(override_texts(wrong))
    assert str(refused.value).startswith(sentence)


def test_a_grid_lists_every_combination() -> None:
    grid = {"seed": range(2), "strategy": ["fedavg", "krum"], "agent.hidden": [[8], [4, 4]]}
    found = combinations(parse(grid_texts(grid), sweep=True))
    assert len(found) == 8
    assert found[1] == ["seed=0", "strategy=fedavg", "agent.hidden=[4,4]"]


@pytest.mark.parametrize("values", ["0,1", 3, [], {"a": 1}])
def test_a_grid_needs_lists(values: Any) -> None:
    with pytest.raises(ConfigError, match="allowed is a list of values"):
        grid_texts({"seed": values})
