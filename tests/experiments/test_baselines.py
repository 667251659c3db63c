"""Baselines on the command line: trained, played, compared, and refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conf import compose, robot_network
from env.episode import EpisodeAccumulator
from env.oracles import per_slot
from env.oracles.trajectory import shortest_ways
from env.world import World
from experiments.analysis import optimality_gap
from experiments.cli import main
from training.evaluation import Evaluator

SHORTEST = ("env.robots=2", "env.room.cell_m=2.0")


def evaluated(out: Path, *arguments: str) -> dict[str, Any]:
    """What ``risfleet evaluate`` writes."""
    assert main(["evaluate", *arguments, "--json", str(out)]) == 0
    written: dict[str, Any] = json.loads(out.read_text())
    return written


SERVING = (
    "env.reward.credit=difference",
    "env.reward.weights=objective",
    "env.state.weights=true",
    "env.state.others=1",
    "train.worlds=2",
)
TRAINED = (
    ("baseline=centralized",),
    ("baseline=branching",),
    ("baseline=fixed_phase",),
    ("scheme.power=ap",),
    ("scheme.power=search",),
    ("baseline=oracle_phase", "scheme.power=search"),
    ("baseline=centralized", "scheme.power=ap"),
    ("baseline=centralized", *SERVING),
    ("baseline=branching", "scheme.heads=shared", *SERVING),
    ("baseline=oracle_phase", "scheme.power=search", "env.state.order=gain", *SERVING),
    ("env.access=oma", "env.metric=qoe", "env.state.order=gain", *SERVING),
)


@pytest.mark.parametrize("what", TRAINED, ids=" ".join)
def test_what_was_trained_is_played_and_compared_like_any_run(
    tiny_overrides: tuple[str, ...], tmp_path: Path, what: tuple[str, ...]
) -> None:
    folder, out = tmp_path / "run", tmp_path / "out.json"
    short = ("env.robots=2", "train.max_ticks=20", "evaluation.episodes=2")
    given = [*tiny_overrides, *short, *what, f"run.dir={folder}"]
    assert main(["train", *given]) == 0
    summary = json.loads((folder / "summary.json").read_text())
    found = evaluated(out, str(folder))
    for column, name in (("eps = 0", "greedy"), ("eps = 0.05", "eps05")):
        for measure in ("success", "ee", "sum_rate"):
            assert found[column][measure] == summary["evaluation"][name][measure]
    options = ["--episodes", "2", "--slack", "0", "--json", str(out)]
    assert main(["oracle", str(folder), *options]) == 0
    assert "gap" in json.loads(out.read_text())


def test_best_powers_on_shortest_ways_are_the_oracles(tmp_path: Path) -> None:
    found = evaluated(tmp_path / "out.json", "baseline=shortest_best", *SHORTEST, "--episodes", "6")
    oracle = optimality_gap.shortest_measures(Evaluator(compose(SHORTEST), episodes=6), 0)
    expected = oracle[optimality_gap.POWERS].summary()
    assert list(found) == ["eps = 0"]
    for measure in ("ee", "sum_rate", "min_rate", "success", "path_ratio"):
        assert found["eps = 0"][measure] == pytest.approx(expected[measure], rel=1e-12)


@pytest.mark.parametrize("phase", ["oracle", "fixed", "random"])
def test_shortest_ways_arrive_and_canonical_powers_need_no_projection(
    tmp_path: Path, phase: str
) -> None:
    given = ["baseline=shortest_canonical", f"scheme.phase={phase}", *SHORTEST]
    found = evaluated(tmp_path / "a.json", *given)["eps = 0"]
    assert (found["success"], found["path_ratio"], found["projections"]) == (1.0, 1.0, 0.0)
    assert evaluated(tmp_path / "b.json", *given)["eps = 0"] == found


def test_the_oracle_phase_with_canonical_powers_is_the_best_of_each_slot(tmp_path: Path) -> None:
    given = ["baseline=shortest_canonical", *SHORTEST]
    found = evaluated(tmp_path / "out.json", *given, "--episodes", "5")["eps = 0"]
    evaluator = Evaluator(compose(SHORTEST), episodes=5)
    world = evaluator.world
    world.reset(evaluator.starts)
    tally, rows = EpisodeAccumulator(world), np.arange(5)
    while world.driving.any():
        sums = np.stack([_sum_rate(world, phase) for phase in range(4)])
        phase = sums.argmax(axis=0)
        gain = per_slot.phase_gains(world)[rows, phase]
        level = per_slot.canonical_levels(gain, world.driving, 6)
        tally.add(world.step(phase, shortest_ways(world, world.cell), level))
    assert found["sum_rate"] == pytest.approx(tally.measures().summary()["sum_rate"], rel=1e-12)


def _sum_rate(world: World, phase: int) -> np.ndarray:
    """The sum rate of a slot under a phase with canonical powers, shape (B,)."""
    gain = per_slot.phase_gains(world)[:, phase]
    level = per_slot.canonical_levels(gain, world.driving, 6)
    return world.downlink.allocate(gain, level, world.driving).rate.sum(axis=-1)


def test_random_phases_do_not_depend_on_what_is_played_beside_them() -> None:
    config = compose([*SHORTEST, "baseline=random_phase", "evaluation.episodes=4"])
    size = robot_network(config).parameters
    weights = np.zeros((1, size), np.float32), np.zeros(0, np.float32)
    evaluator = Evaluator(config)
    both = evaluator.play(*weights, (0.3, 0.0))
    for index, epsilon in enumerate((0.3, 0.0)):
        (alone,) = evaluator.play(*weights, (epsilon,))
        np.testing.assert_array_equal(alone.ee, both[index].ee)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["train", "baseline=shortest_best"], "risfleet evaluate plays it"),
        (["train", "-m", "baseline=none,shortest_best"], "risfleet evaluate plays it"),
        (["evaluate", "baseline=centralized"], "allowed without a run's folder is what learns"),
        (["evaluate", "baseline=shortest_best", "--epsilon", "0.1"], "--epsilon 0.1: allowed is 0"),
        (["evaluate", "nowhere", "seed=1"], "allowed is one run folder"),
        (["evaluate", "baseline=shortest"], "baseline=shortest: allowed is one of "),
        (
            ["evaluate", "baseline=shortest_best", "env.power.resolve=zero", "env.robots=12"],
            "combinations of powers to search",
        ),
    ],
)
def test_mistakes_cost_one_sentence(
    arguments: list[str], said: str, refused: Callable[..., str]
) -> None:
    assert said in refused(*arguments)
