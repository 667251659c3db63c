"""The networks that a configuration describes, and how the model card says so."""

from __future__ import annotations

from types import SimpleNamespace

from conf import ap_network, compose, robot_network
from experiments.reproduce.export import card


def test_the_last_layer_has_an_output_for_each_action() -> None:
    config = compose()
    assert robot_network(config).layers[-1] == (64, 24)
    assert ap_network(config).layers[-1] == (64, 4)
    row = card._sizes(SimpleNamespace(name="mine", run=SimpleNamespace(config=config)))
    assert " - 64 - 64 - 24 | " in row
    assert " - 64 - 64 - 4 | " in row
