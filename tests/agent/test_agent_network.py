"""The flat layout and the forward used to act."""

import numpy as np
import pytest
import torch
from agent_helpers import same_bits
from hypothesis import given
from hypothesis import strategies as st

from agent import NetworkShape, q_values
from storage.checkpoint_files import digest

SHAPE = NetworkShape(5, (13, 27), 24)
widths = st.integers(1, 70)


def networks(shape, agents, seed=0):
    rng = np.random.default_rng(seed)
    return np.stack([shape.initial_weights(rng) for _ in range(agents)])


def test_parameters_counts_weights_and_biases():
    assert SHAPE.parameters == 5 * 13 + 13 + 13 * 27 + 27 + 27 * 24 + 24


def test_numpy_and_torch_views_share_the_row():
    flat = np.zeros((2, 2, SHAPE.parameters + 3), np.float32)[:, 0, : SHAPE.parameters]
    for rows in (flat, torch.from_numpy(flat)):
        for weight, bias in SHAPE.views(rows):  # type: ignore[type-var]
            weight += 1
            bias += 1
    assert (flat == 2).all()


@given(
    sizes=st.tuples(widths, st.lists(widths, min_size=1, max_size=3), widths),
    agents=st.integers(2, 5),
    rows=st.sampled_from([1, 2, 50]),
    shift=st.integers(0, 17),
)
def test_q_values_are_the_same_bits_stacked_or_alone(sizes, agents, rows, shift):
    shape = NetworkShape(sizes[0], tuple(sizes[1]), sizes[2])
    weights = networks(shape, agents)
    seen = np.random.default_rng(1).normal(size=(agents, rows, shape.inputs)).astype(np.float32)
    stacked = q_values(shape, weights, seen)
    moved = np.zeros((agents, shape.parameters + shift), np.float32)[:, shift:]
    moved[:] = weights
    assert same_bits(q_values(shape, moved, seen), stacked)
    for agent in range(agents):
        own = slice(agent, agent + 1)
        alone = q_values(shape, weights[own].copy(), seen[own].copy())
        assert same_bits(alone[0], stacked[agent])


def test_q_values_agree_with_torch():
    weights, seen = networks(SHAPE, 2), np.ones((2, 3, 5), np.float32)
    for agent, q in enumerate(q_values(SHAPE, weights, seen)):
        x = torch.from_numpy(seen[agent])
        for depth, (weight, bias) in enumerate(SHAPE.views(torch.from_numpy(weights))):
            x = x if depth == 0 else torch.relu(x)
            x = x @ weight[agent] + bias[agent]
        np.testing.assert_allclose(q, x, rtol=1e-5, atol=1e-6)


def test_first_weights_fill_the_range_of_torch_linear():
    shape = NetworkShape(16, (400,), 300)
    row = shape.initial_weights(np.random.default_rng(0))
    for (weight, bias), inputs in zip(shape.views(row[None]), (16, 400), strict=True):
        bound = inputs**-0.5
        layer = torch.nn.Linear(inputs, weight.shape[2])
        assert abs(weight).max() <= bound
        assert abs(bias).max() <= bound
        assert weight.std() == pytest.approx(float(layer.weight.detach().std()), rel=0.05)
        assert abs(weight.mean()) < 0.05 * bound


def test_first_weights_follow_from_the_generator_alone():
    one, same, other = (SHAPE.initial_weights(np.random.default_rng(s)) for s in (1, 1, 2))
    assert one.dtype == np.float32
    assert digest(one) == digest(same) != digest(other)
