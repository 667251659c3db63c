"""A mean in which robots count by what they have visited, by hand."""

from __future__ import annotations

import numpy as np

from agent import NetworkShape
from training.aggregation.visits import VisitMean

ACTIONS = 3
COUNTS = np.array([[1, 0, 0], [2, 3, 0]])


def rows(shape: NetworkShape) -> np.ndarray:
    return np.random.default_rng(1).normal(size=(2, 2, shape.parameters)).astype(np.float32)


def test_outputs_count_by_their_action_and_all_else_by_transitions():
    shape = NetworkShape(4, (5,), ACTIONS)
    uploads = rows(shape)
    first, second = uploads.astype(np.float64)
    found = VisitMean(shape).mean(uploads, COUNTS)
    shares = {0: 1 / 3, 1: 0.0, 2: 0.5}  # of the first robot; nobody has taken the last action
    for hidden, one, other in zip(
        *(shape.matrices(x)[:1] for x in (found, first, second)), strict=True
    ):
        np.testing.assert_allclose(hidden, one / 6 + other * 5 / 6, atol=1e-6)
    last, one, other = (shape.matrices(x)[-1] for x in (found, first, second))
    for action, share in shares.items():
        expected = share * one[..., action] + (1 - share) * other[..., action]
        np.testing.assert_allclose(last[..., action], expected, atol=1e-6)


def test_where_nobody_has_visited_anything_all_count_alike():
    shape = NetworkShape(4, (5,), ACTIONS)
    uploads = rows(shape)
    found = VisitMean(shape).mean(uploads, np.zeros_like(COUNTS))
    np.testing.assert_allclose(found, uploads.astype(np.float64).mean(axis=0), atol=1e-7)


def test_robots_that_agree_keep_their_weights_to_the_bit():
    shape = NetworkShape(4, (5, 6), ACTIONS)
    uploads = np.repeat(rows(shape)[:1], 3, axis=0)
    counts = np.array([[1, 2, 3], [0, 7, 0], [9, 0, 1]])
    found = VisitMean(shape).mean(uploads, counts)
    assert found.tobytes() == uploads[0].tobytes()
