"""Ways of learning beyond the paper's: more updates, falling rates."""

from itertools import pairwise

import numpy as np
import pytest
from agent_helpers import Experience, fleet, live, same_bits, shape_of, small_config

from agent import TargetConfig
from agent.learning.learner import learning_rate_at


def test_the_target_is_copied_once_where_several_transitions_are_stored_at_once():
    config = small_config(target=TargetConfig(every=10), learn_from=60)
    shape, worlds = shape_of(config), 4
    copies: list[int] = []
    agent = fleet(shape, config, [1], worlds=worlds)
    agent._learner.copy_to_target = copies.append
    seen, on = np.zeros((worlds, shape.inputs), np.float32), np.ones(worlds, dtype=bool)
    for stored, copied in ((4, 0), (8, 0), (12, 1), (16, 1), (20, 2)):
        agent.learn(seen, [0] * worlds, [1.0] * worlds, seen, ~on, on)
        assert agent._replays[0].added == stored
        assert copies == [0] * copied


def test_several_updates_follow_each_transition():
    config = small_config(updates=3, learn_from=20)
    experience = Experience(shape_of(config), 1, 25, idle=0)
    agent = fleet(shape_of(config), config, [1])
    live(agent, experience, [0])
    assert agent.agent_state(0)["updates"] == 3 * 6


def test_the_learning_rate_falls_over_an_agents_own_updates():
    config = small_config(learning_rate_end=2e-4, learning_rate_updates=10)
    rates = [learning_rate_at(config, updates) for updates in range(15)]
    assert rates[0] == 1e-3
    assert rates[5] == pytest.approx(6e-4)
    assert rates[10:] == [pytest.approx(2e-4)] * 5
    assert all(later <= earlier for earlier, later in pairwise(rates))
    assert learning_rate_at(small_config(), 10**6) == 1e-3


def test_a_rate_that_has_fallen_to_zero_moves_nothing():
    config = small_config(learning_rate_end=0.0, learning_rate_updates=5)
    experience = Experience(shape_of(config), 1, 60, idle=0)
    agent = fleet(shape_of(config), config, [1])
    live(agent, experience, [0], stop=25)  # six updates
    before = agent.online.copy()
    live(agent, experience, [0], start=25)
    assert same_bits(agent.online, before)
