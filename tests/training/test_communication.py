"""Bytes by hand: what federated learning, the link and a central learner send."""

import pytest

from conf import compose
from training.communication import per_tick, waiting

# 5 numbers in, 2 x 64 hidden, 4 directions times 6 levels: (5+1) 64 + (64+1) 64 + (64+1) 24.
PARAMETERS = 384 + 4160 + 1560


def test_the_defaults_by_hand():
    config = compose(["federation.clients=3"])
    found = per_tick(config)
    assert found["weights_per_window"] == 3 * 2 * 2 * 4 * PARAMETERS == 292_992
    assert found["weights"] == 292_992 / 25
    # observation 5, next observation 5, action, reward, terminal: 13 numbers of 4 bytes
    assert found["transitions"] == 3 * 52
    assert found["transitions_per_window"] == 25 * 156
    # a step: header 12, head 16, a record of 26; its answer: header 12, head 12, an action of 4
    assert found["lockstep_per_window"] == 3 * (26 * (12 + 16 + 26) + 25 * (12 + 12 + 4))
    assert found["weights_over_transitions"] == pytest.approx(292_992 / 3900)
    assert found["break_even_every"] == 292_992 / 156


def test_worlds_credit_and_broadcasts_by_hand():
    changes = ["train.worlds=4", "env.reward.credit=difference", "env.state.others=1"]
    found = per_tick(compose(["federation.clients=3", *changes]))
    # observation 5 + 8 that are broadcast, twice, action, reward, terminal: 29 numbers of 4 bytes
    assert found["transitions"] == 4 * 3 * 4 * 29
    # a record: 26, a credit of 8, broadcasts of 8 numbers before and now; one in each of 4 worlds
    step, answer = 12 + 16 + 4 * (26 + 8 + 2 * 8 * 4), 12 + 12 + 4 * 4
    assert found["lockstep_per_window"] == 3 * (26 * step + 25 * answer)
    parameters = PARAMETERS + 8 * 64
    assert found["weights_per_window"] == 3 * 2 * 2 * 4 * parameters
    assert found["break_even_every"] == 3 * 2 * 2 * 4 * parameters / found["transitions"]


def test_at_the_break_even_both_send_as_much():
    small = ["env.state.destination=none", "env.power.levels=2", "env.robots=2", "agent.hidden=[8]"]
    # (3+1) 8 + (8+1) 8 = 104 parameters, 2 networks up and down; 9 numbers a transition
    found = per_tick(compose(small))
    assert found["break_even_every"] == 4 * 104 / 9
    assert found["weights_over_transitions"] == pytest.approx(4 * 104 / 9 / 25)
    more = per_tick(compose([*small, "federation.every=416"]))
    assert more["weights"] * 9 == more["transitions"]


def test_without_aggregation_weights_only_go_up():
    averaged, alone = (per_tick(compose([f"strategy={name}"])) for name in ("fedavg", "none"))
    assert alone["weights"] == averaged["weights"] / 2


def test_fewer_clients_save_headers_and_nothing_else_on_the_link():
    one, three = (
        per_tick(compose(["runtime=deployment", f"federation.clients={clients}"]))
        for clients in (1, 3)
    )
    assert three["lockstep_per_window"] - one["lockstep_per_window"] == 2 * (26 * 28 + 25 * 24)
    assert one["weights"] == three["weights"]


def test_waiting_is_a_mean_over_exchanges():
    clients = [
        {"robots": [0], "exchanges": 4, "awaited_s": 0.002, "ahead_s": 0.001},
        {"robots": [1], "exchanges": 0, "awaited_s": 0.0, "ahead_s": 0.0},
    ]
    assert waiting(clients) == [
        {"robots": [0], "awaited_us": 500.0, "ahead_us": 250.0},
        {"robots": [1], "awaited_us": 0.0, "ahead_us": 0.0},
    ]


def test_gossip_sends_to_neighbours_and_own_parts_send_nothing():
    six = ["env.robots=6", "strategy=gossip"]
    of_one = 2 * 4 * PARAMETERS
    ring, complete, random = (
        per_tick(compose([*six, f"strategy.graph={graph}"]))["weights_per_window"]
        for graph in ("ring", "complete", "random")
    )
    assert (ring, complete) == (6 * 2 * of_one, 6 * 5 * of_one)
    # each picks one of five: an edge stands unless neither picks the other, 1 - (4/5)^2 = 9/25
    assert random == pytest.approx(6 * 5 * 9 / 25 * of_one)
    heads = per_tick(compose(["federation.own=heads"]))["weights_per_window"]
    assert heads == 3 * 2 * 2 * 4 * (384 + 4160)
