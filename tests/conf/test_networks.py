"""The networks that a configuration describes, and how the model card says so."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from conf import ap_network, compose, robot_network
from experiments.reproduce.export import card


@pytest.mark.parametrize(
    ("override", "robots", "ap"),
    [
        ("agent.dueling=false", 24, 4),
        ("agent.dueling=true", 24 + 1, 4 + 1),
    ],
)
def test_the_last_layer_has_an_output_for_whatever_makes_values(
    override: str, robots: int, ap: int
) -> None:
    config = compose([override])
    assert robot_network(config).layers[-1] == (64, robots)
    assert ap_network(config).layers[-1] == (64, ap)
    assert robot_network(config).actions == 24
    row = card._sizes(SimpleNamespace(name="mine", run=SimpleNamespace(config=config)))
    assert f" - 64 - 64 - {robots} | " in row
    assert f" - 64 - 64 - {ap} | " in row
