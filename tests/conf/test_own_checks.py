"""Own parts and gossip beside what they do not go with: one sentence each."""

from __future__ import annotations

import pytest

from conf import ConfigError, compose


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (["federation.own=tail"], "one of none, heads, trunk, input, normalisation"),
        (["federation.own=heads", "strategy.name=none"], "none with strategy=none"),
        (["federation.own=heads", "strategy=fedadam"], "none with strategy=fedadam"),
        (["federation.own=heads", "strategy.name=gossip"], "none with strategy=gossip"),
        (["federation.own=heads", "experiment=building"], "none in a building"),
        (["strategy.name=gossip", "experiment=building"], "any other in a building"),
        (["experiment=building", "rooms.strategy.name=visits"], "any other across rooms"),
        (
            ["federation.own=heads", "baseline=centralized"],
            "none where robots have no networks",
        ),
        (
            ["federation.own=trunk", "federation.compression.down=q8"],
            "none with federation.own=trunk: robots are not given one model",
        ),
        (
            ["strategy.name=gossip", "federation.compression.targets=copied"],
            "averaged with strategy=gossip: robots are not given one model",
        ),
        (
            ["federation.own=heads", "federation.compression.up=q8"],
            "none with federation.own=heads",
        ),
        (["federation.own=heads", "strategy.dp.name=local"], "none with federation.own=heads"),
        (["strategy.name=gossip", "federation.hear=1"], "null with strategy=gossip"),
        (["strategy.name=gossip", "attack=flip"], "none with strategy=gossip"),
        (["federation.hear=1", "federation.fraction=0.5"], "1.0 with federation.hear"),
        (["strategy.name=visits", "federation.losses.late=0.5"], "0.0 with strategy=visits"),
        (["strategy.name=fedtrimmedavg", "strategy.trim=0.2"], "at least 1 / env.robots=3"),
        (["strategy.dp.name=central", "federation.own=heads"], "none with strategy/dp=central"),
        (["strategy.dp.name=adaptive", "federation.hear=2"], "null with strategy/dp=adaptive"),
        (
            ["strategy.dp.name=central", "federation.losses.late=0.1"],
            "0.0 with strategy/dp=central",
        ),
        (["strategy=bulyan", "federation.hear=2"], "null with strategy=bulyan"),
        (["strategy.name=gossip", "env.robots=1"], "env.robots of at least 2, not 1"),
    ],
)
def test_what_does_not_go_together_is_refused_in_a_sentence(composed, changes, said):
    with pytest.raises(ConfigError) as refused:
        composed(changes)
    message = str(refused.value)
    assert said in message
    assert "\n" not in message.strip()


@pytest.mark.parametrize(
    "changes",
    [
        ["federation.own=heads", "strategy=krum"],
        ["federation.own=normalisation", "strategy=fedprox"],
        ["strategy=gossip", "strategy.graph=random", "strategy.degree=2", "train.worlds=2"],
        ["strategy=visits"],
        ["strategy/dp=local", "federation.hear=2", "federation.losses.probability=0.5"],
    ],
)
def test_what_goes_together_is_taken(changes):
    compose(changes)
