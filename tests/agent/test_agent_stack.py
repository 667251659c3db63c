"""An agent alone, stacked with others, or moved between stacks ends in the same bits."""

import numpy as np
import pytest
from agent_helpers import Experience, fleet, live, same_bits, shape_of, small_config
from hypothesis import given, settings
from hypothesis import strategies as st

from agent import DiscountConfig, TargetConfig
from agent.replay import RowLayout

ALL = {
    "double": True,
    "updates": 3,
    "learning_rate_end": 1e-4,
    "learning_rate_updates": 100,
    "target": TargetConfig(tau=0.02),
}
VARIANTS = {
    "plain": ({}, 0.8, 0.0),
    "default widths": ({"hidden": [64, 64], "batch_size": 128, "replay_size": 300}, 0.8, 0.0),
    "wide enough for torch": ({"hidden": [129, 131], "batch_size": 128}, 0.8, 0.0),
    "one layer, batch of one": ({"hidden": [9], "batch_size": 1}, 0.8, 0.0),
    "odd batch": ({"batch_size": 33, "hidden": [65, 31, 17]}, 0.8, 0.0),
    "no discount": ({}, 0.0, 0.0),
    "double": ({"double": True}, 0.8, 0.0),
    "soft target": ({"target": TargetConfig(tau=0.05)}, 0.8, 0.0),
    "FedProx": ({}, 0.8, 0.01),
    "frequent copies": ({"target": TargetConfig(every=7), "huber_delta": 0.3}, 0.8, 0.0),
    "two updates": ({"updates": 2}, 0.8, 0.0),
    "falling rate": ({"learning_rate_end": 1e-5, "learning_rate_updates": 60}, 0.8, 0.0),
    "all of them": (ALL, 0.8, 0.01),
}


def adapted(changes):
    changes = dict(changes)
    if changes.get("batch_size", 0) > 60:
        changes.setdefault("replay_size", 200)
    return small_config(**changes)


@pytest.mark.parametrize("variant", VARIANTS)
def test_an_agent_ends_in_the_same_bits_alone_and_stacked(variant):
    changes, discount, mu = VARIANTS[variant]
    config = adapted(changes)
    shape, ticks = shape_of(config), 150
    experience = Experience(shape, 4, ticks)
    seeds = [3, 5, 8, 13]
    together = fleet(shape, config, seeds, discount, mu)
    actions, losses = live(together, experience, [0, 1, 2, 3])
    for agent, seed in enumerate(seeds):
        alone = fleet(shape, config, [seed], discount, mu)
        own_actions, own_losses = live(alone, experience, [agent])
        assert same_bits(own_actions[:, 0], actions[:, agent])
        assert same_bits(own_losses[:, 0], losses[:, agent])
        for name, array in alone.agent_state(0).items():
            assert same_bits(array, together.agent_state(agent)[name]), name


@pytest.mark.parametrize("variant", ["plain", "no discount", "FedProx", "all of them"])
def test_an_agent_in_four_worlds_ends_in_the_same_bits_alone_stacked_and_saved(variant):
    changes, discount, mu = VARIANTS[variant]
    config = adapted(changes)
    shape, worlds, seeds = shape_of(config), 4, [3, 5, 8]
    experience = Experience(shape, 3 * worlds, 90, late=4)
    together = fleet(shape, config, seeds, discount, mu, worlds)
    actions, losses = live(together, experience, range(12))
    assert np.isfinite(losses[-1]).all()
    for agent, seed in enumerate(seeds):
        own = slice(worlds * agent, worlds * (agent + 1))
        first = fleet(shape, config, [seed], discount, mu, worlds)
        before = live(first, experience, own, stop=40)
        alone = fleet(shape, config, [99], discount, mu, worlds)
        alone.restore_agent(0, first.agent_state(0))
        after = live(alone, experience, own, start=40)
        assert same_bits(np.concatenate([before[0], after[0]]), actions[:, own])
        assert same_bits(np.concatenate([before[1], after[1]])[:, 0], losses[:, agent])
        for name, array in alone.agent_state(0).items():
            assert same_bits(array, together.agent_state(agent)[name]), name


@pytest.mark.parametrize(("worlds", "learn_from", "first"), [(1, 20, 19), (4, 20, 4), (4, 21, 5)])
def test_transitions_of_all_worlds_count_and_a_tick_has_one_gradient_step(
    worlds, learn_from, first
):
    config = small_config(learn_from=learn_from, target=TargetConfig(every=16))
    shape, copied = shape_of(config), []
    experience = Experience(shape, worlds, 40, idle=0.0, late=0)
    agents = fleet(shape, config, [1], worlds=worlds)
    for tick in range(40):
        before = agents.target.copy()
        _, losses = live(agents, experience, range(worlds), start=tick, stop=tick + 1)
        assert np.isfinite(losses[0, 0]) == (tick >= first)
        assert agents.agent_state(0)["updates"].item() == max(0, tick - first + 1)
        if not same_bits(agents.target, before):
            copied.append(tick)
    assert copied == [tick for tick in range(40) if worlds * (tick + 1) % 16 == 0]


def test_many_worlds_store_their_own_transitions_in_the_order_of_the_worlds():
    config = small_config(learn_from=60)
    shape, worlds = shape_of(config), 3
    experience = Experience(shape, worlds, 15, idle=0.4, late=0)
    agents = fleet(shape, config, [1], worlds=worlds)
    actions, _ = live(agents, experience, range(worlds))
    layout, active = RowLayout(shape.inputs), experience.active
    assert 15 < active.sum() < 45
    found = layout.unpack(agents.agent_state(0)["replay"])
    expected = (
        experience.observations[active],
        actions[active],
        (config.reward_scale * experience.rewards[active]).astype(np.float32),
        experience.next[active],
        experience.terminal[active],
    )
    for stored, given_field in zip(found, expected, strict=True):
        np.testing.assert_allclose(np.asarray(stored), np.asarray(given_field), rtol=1e-6)


@settings(max_examples=12)
@given(
    hidden=st.lists(st.integers(1, 40), min_size=1, max_size=3),
    batch=st.integers(1, 24),
    sizes=st.tuples(st.integers(1, 12), st.integers(1, 12)),
    members=st.permutations(range(4)).map(lambda order: order[:2]),
)
def test_stacking_never_shows_whatever_the_sizes(hidden, batch, sizes, members):
    config = small_config(hidden=hidden, batch_size=batch)
    shape = shape_of(config, *sizes)
    experience = Experience(shape, 4, 60, idle=0.4, late=3)
    seeds = [3, 5, 8, 13]
    four, two = fleet(shape, config, seeds), fleet(shape, config, [seeds[m] for m in members])
    live(four, experience, range(4))
    live(two, experience, members)
    assert same_bits(two.weights(), four.weights()[list(members)])


def test_an_idle_agent_does_not_change_at_all():
    config = small_config(target=TargetConfig(every=1))
    shape = shape_of(config)
    experience = Experience(shape, 3, 80, late=0)
    agents = fleet(shape, config, [1, 2, 3], mu=0.1)
    live(agents, experience, range(3), stop=50)
    before = agents.agent_state(1)
    experience.active[50:, 1] = False
    actions, losses = live(agents, experience, range(3), start=50)
    assert (actions[:, 1] == -1).all()
    assert np.isnan(losses[:, 1]).all()
    for name, array in agents.agent_state(1).items():
        assert same_bits(array, before[name]), name


@pytest.mark.parametrize("variant", ["plain", "double", "soft target", "FedProx", "all of them"])
def test_an_agent_saved_from_a_stack_goes_on_alone_to_the_same_bits(variant):
    changes, discount, mu = VARIANTS[variant]
    config = adapted(changes)
    shape = shape_of(config)
    experience = Experience(shape, 3, 140)
    together = fleet(shape, config, [1, 2, 3], discount, mu)
    live(together, experience, range(3), stop=70)
    alone = fleet(shape, config, [99], discount, mu)
    alone.restore_agent(0, together.agent_state(1))
    live(together, experience, range(3), start=70)
    live(alone, experience, [1], start=70)
    for name, array in alone.agent_state(0).items():
        assert same_bits(array, together.agent_state(1)[name]), name


def test_saved_restored_and_continued_equals_uninterrupted():
    config = small_config(discount=DiscountConfig(robot=0.9))
    shape = shape_of(config)
    experience = Experience(shape, 2, 200)
    whole = fleet(shape, config, [1, 2])
    live(whole, experience, range(2))
    first = fleet(shape, config, [1, 2])
    live(first, experience, range(2), stop=90)
    state = first.state()
    live(first, experience, range(2), start=90)  # the state is a copy: this must not reach it
    second = fleet(shape, config, [7, 9])
    second.restore(state)
    live(second, experience, range(2), start=90)
    for name, array in whole.state().items():
        assert same_bits(array, second.state()[name]), name


def test_a_state_of_another_network_is_refused():
    config = small_config()
    other = fleet(shape_of(config, inputs=4), config, [1])
    with pytest.raises(ValueError, match="do not fit this network"):
        other.restore_agent(0, fleet(shape_of(config), config, [1]).agent_state(0))
