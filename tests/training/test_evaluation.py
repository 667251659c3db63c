"""Frozen evaluation: what it plays depends on the seed and the weights alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from safetensors.numpy import load_file

from conf import Config
from env.episode import EpisodeMeasures
from env.world import World
from experiments.runtimes import local
from training.controllers.policies import Decision, Exploration, PolicyWeights, frozen_policy
from training.evaluation import Evaluator
from training.run_folder import RunFolder
from training.trace import Trace

Tiny = Callable[..., Config]
Weights = tuple[NDArray[np.float32], NDArray[np.float32]]


@pytest.fixture
def weights(tiny_run: Path) -> Weights:
    """Online weights of the tiny run: robots (3, P) and access point (P_AP,)."""
    arrays = load_file(tiny_run / "weights.safetensors")
    return arrays["robots"][:, 0], arrays["ap"][0]


def same(one: EpisodeMeasures, other: EpisodeMeasures) -> bool:
    pairs = ((vars(one)[name], vars(other)[name]) for name in vars(one))
    return all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


def test_frozen_weights_stay_as_they_were(tiny: Tiny, weights: Weights) -> None:
    before = [part.tobytes() for part in weights]
    Evaluator(tiny()).play(*weights, (0.05, 0.0))
    assert [part.tobytes() for part in weights] == before


def test_an_evaluation_repeats_itself(tiny: Tiny, weights: Weights) -> None:
    evaluator = Evaluator(tiny())
    first, again = evaluator.play(*weights, (0.3,)), evaluator.play(*weights, (0.3,))
    assert same(first[0], again[0])
    assert same(first[0], Evaluator(tiny()).play(*weights, (0.3,))[0])


def test_a_policy_of_ones_own_is_played_from_the_same_starts(tiny: Tiny, weights: Weights) -> None:
    config = tiny()
    played: list[NDArray[np.int64]] = []
    robots = frozen_policy(config, Evaluator(config).world)

    def watched(world: World, known: PolicyWeights, exploration: Exploration) -> Decision:
        played.append(world.cell)
        return robots(world, known, exploration)

    given = Evaluator(config, policy=watched)
    assert same(given.play(*weights, (0.3,))[0], Evaluator(config).play(*weights, (0.3,))[0])
    np.testing.assert_array_equal(played[0], Evaluator(config).starts)


@pytest.mark.parametrize("fading", ["static", "slot"])
def test_what_is_played_beside_it_changes_no_evaluation(
    tiny: Tiny, weights: Weights, fading: str
) -> None:
    evaluator = Evaluator(tiny({"evaluation.episodes": 16, "env.channel.fading": fading}))
    together = evaluator.play(*weights, (0.3, 0.0, 0.6))
    for epsilon, measures in zip((0.3, 0.0, 0.6), together, strict=True):
        assert same(measures, evaluator.play(*weights, (epsilon,))[0])
        assert same(measures, evaluator.play(*weights, (0.1, epsilon))[1])
    assert not same(together[0], together[1])


def test_equal_robots_give_what_one_shared_network_gives(tiny: Tiny, weights: Weights) -> None:
    robots, ap = weights
    evaluator = Evaluator(tiny())
    assert (robots == robots[0]).all()
    assert same(evaluator.play(robots, ap, (0.2,))[0], evaluator.play(robots[:1], ap, (0.2,))[0])


def test_each_robot_follows_its_own_network(tiny: Tiny, weights: Weights) -> None:
    robots, ap = weights
    evaluator = Evaluator(tiny())
    traces = Trace(), Trace()
    evaluator.play(robots, ap, (0.0,), traces[0].see)
    other = robots.copy()
    other[1] = np.random.default_rng(0).normal(size=robots.shape[1]).astype(np.float32)  # type: ignore[attr-defined]
    evaluator.play(other, ap, (0.0,), traces[1].see)
    length = min(len(trace.cells) for trace in traces)
    before, after = (np.stack(trace.cells[:length]) for trace in traces)
    assert (before[..., 1] != after[..., 1]).any()
    np.testing.assert_array_equal(before[..., [0, 2]], after[..., [0, 2]])


def test_starts_are_held_out_and_the_same_for_every_number_of_calls(
    tiny: Tiny, weights: Weights
) -> None:
    evaluator = Evaluator(tiny())
    starts = []
    for epsilons in ((0.0,), (0.5, 0.0), (0.2,)):
        trace = Trace()
        evaluator.play(*weights, epsilons, trace.see)
        starts += [trace.cells[0][i : i + 4] for i in range(0, 4 * len(epsilons), 4)]
    assert all(np.array_equal(starts[0], start) for start in starts)
    other = Trace()
    Evaluator(tiny({"seed": 1})).play(*weights, (0.0,), other.see)
    assert not np.array_equal(starts[0], other.cells[0])


def test_other_starts_keep_the_task(tiny: Tiny) -> None:
    config = tiny({"env.robots": 6, "env.tasks.destinations_m": []})
    run, other = Evaluator(config), Evaluator(config, starts_seed=7)
    assert not np.array_equal(run.world.draw_starts(4), other.world.draw_starts(4))
    np.testing.assert_array_equal(run.world.destinations, other.world.destinations)


def test_a_seed_of_starts_that_is_the_runs_changes_nothing(tiny: Tiny, weights: Weights) -> None:
    (expected,) = Evaluator(tiny()).play(*weights, (0.3,))
    (found,) = Evaluator(tiny(), starts_seed=tiny().seed).play(*weights, (0.3,))
    assert same(expected, found)
    (found,) = Evaluator(tiny(), starts_seed=tiny().seed + 1).play(*weights, (0.3,))
    assert not same(expected, found)


def test_more_episodes_can_be_asked_for(tiny: Tiny, weights: Weights) -> None:
    (measures,) = Evaluator(tiny(), episodes=7).play(*weights, (0.05,))
    assert measures.success.shape == (7,)


def test_a_trace_moves_a_cell_at_a_time(tiny: Tiny, weights: Weights) -> None:
    evaluator = Evaluator(tiny())
    trace = Trace()
    evaluator.play(*weights, (0.5,), trace.see)
    trace.finish(evaluator.world)
    ways = trace.ways_m(evaluator.world)
    steps = np.abs(np.diff(ways, axis=0)).sum(axis=-1)
    assert set(np.unique(steps)) <= {0.0, 1.0}
    assert ways.shape == (len(trace.cells), 4, 3, 2)


@pytest.mark.parametrize("every", [1, 1000])
def test_evaluating_changes_nothing_in_the_training(
    tiny: Tiny, tmp_path: Path, play: Callable[..., Any], every: int
) -> None:
    config = tiny({"evaluation.every": every, "evaluation.episodes": 3})
    summary = local.train(config, RunFolder(tmp_path))
    assert (summary["digest"]["robots"], summary["digest"]["ap"]) == play(config).digests
