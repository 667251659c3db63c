"""Access points that learn nothing: what they set, and that a run with them is a run."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from conf import Config
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World
from experiments.runtimes import local
from training.controllers.phase_rules import PhaseRule, fixed_phase
from training.run_folder import RunFolder

Tiny = Callable[..., Config]


def world_of(config: Config, worlds: int = 1) -> World:
    scenario = Scenario.drawn(config.env, config.seed)
    world = World(scenario, stream(config.seed, Stream.WORLD), worlds)
    world.reset()
    return world


def test_the_fixed_phase_is_the_best_of_a_single_robot_over_all_cells(tiny: Tiny) -> None:
    """Alone, a robot has P_max / 2: its mean rate over the 48 cells is a sum by hand."""
    for seed in range(3):
        world = world_of(tiny({"env.robots": 1, "env.map_seed": seed}))
        gain = [world.radio_map.gain(np.arange(48), np.array(phase)) for phase in range(4)]
        rates = np.log2(1 + 0.05 * np.array(gain) / 1e-13).mean(axis=-1)
        assert fixed_phase(world, seed) == rates.argmax()
        assert rates.max() > rates.min()


def test_the_fixed_phase_is_the_maps_and_not_the_runs(tiny: Tiny) -> None:
    changes = {"scheme.phase": "fixed", "env.ris.subsurfaces": 4}
    runs = [tiny({**changes, "seed": seed}) for seed in (0, 1)]
    rules = [PhaseRule(config, world_of(config)) for config in runs]
    state = np.zeros((1, 24), np.float32)
    chosen = {int(rule.act(state, tick)[0]) for rule in rules for tick in range(5)}
    assert chosen == {fixed_phase(world_of(runs[0]), runs[0].env.map_seed)}


@pytest.mark.parametrize("metric", ["qos", "qoe"])
def test_no_phase_gives_more_than_the_oracles_for_the_same_picks(tiny: Tiny, metric: str) -> None:
    config = tiny({"scheme.phase": "oracle", "env.ris.subsurfaces": 2, "env.metric": metric})
    rule, draw = PhaseRule(config, world_of(config)), np.random.default_rng(0)
    for _ in range(20):
        world = world_of(config)
        world.reset(world.draw_starts(1))
        level = draw.integers(1, 7, size=(1, 3))
        phase, served = rule.serve(world, rule.act(np.zeros((1, 24), np.float32), 0), level)
        np.testing.assert_array_equal(served, level)
        brought = [
            copy.copy(world).step(np.array([tried]), np.zeros((1, 3), int), level)
            for tried in range(16)
        ]
        sums = [float(outcome.global_reward[0]) for outcome in brought]
        assert sums[int(phase[0])] == max(sums)


def test_random_phases_are_even_and_go_on_from_where_they_were(tiny: Tiny) -> None:
    config = tiny({"scheme.phase": "random"})
    rule, again = PhaseRule(config, world_of(config)), PhaseRule(config, world_of(config))
    state = np.zeros((1, 24), np.float32)
    drawn = [int(rule.act(state, tick)[0]) for tick in range(2000)]
    np.testing.assert_allclose(np.bincount(drawn) / 2000, 0.25, atol=0.04)
    kept = again.state()
    first = [int(again.act(state, tick)[0]) for tick in range(50)]
    again.restore(kept)
    assert [int(again.act(state, tick)[0]) for tick in range(50)] == first == drawn[:50]


@pytest.mark.parametrize("rule", ["random", "fixed", "oracle"])
def test_a_rule_has_no_weights_and_leaves_the_robots_to_learn(
    tiny: Tiny, rule: str, tmp_path: Path, tiny_run: Path
) -> None:
    config = tiny({"scheme.phase": rule})
    summary = local.train(config, RunFolder(tmp_path / "run"))
    assert summary["scheme"]["phase"] == rule
    assert summary["digest"] == local.train(config, RunFolder(tmp_path / "again"))["digest"]
    assert summary["digest"]["robots"] != RunFolder(tiny_run).read_summary()["digest"]["robots"]
    arrays = load_file(tmp_path / "run" / "weights.safetensors")
    assert arrays["ap"].shape == (2, 0)
    assert np.abs(np.diff(arrays["robots"][0], axis=0)).max() > 0
