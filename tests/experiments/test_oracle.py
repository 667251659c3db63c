"""``risfleet oracle``: policies that are bounds, and the parts of a run's gap."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conf import compose, from_yaml
from env.oracles import per_slot
from env.world import World
from experiments.analysis import optimality_gap
from experiments.cli import main
from training.controllers.service import Served
from training.evaluation import Evaluator
from training.run_folder import RunFolder
from training.trace import Trace

SMALL = ("env.robots=2", "env.room.cell_m=2.0")


def test_a_policys_paths_stay_when_phases_and_powers_are_replaced(tiny_run: Path) -> None:
    config = from_yaml((tiny_run / "config.yaml").read_text())
    robots, ap = RunFolder(tiny_run).read_weights(config)
    evaluator = Evaluator(config, episodes=3)

    def best(world: World, served: Served) -> Served:
        return per_slot.best_phase_and_powers(world)

    plain, replaced = Trace(), Trace()
    (played,) = evaluator.play(robots, ap, (0.0,), plain.see)
    (served,) = evaluator.play(
        robots, ap, (0.0,), lambda world, served: replaced.see(world, best(world, served))
    )
    np.testing.assert_array_equal(np.stack(plain.cells), np.stack(replaced.cells))
    assert (served.sum_rate > played.sum_rate).all()


def test_a_service_that_replaces_nothing_changes_nothing(tiny_run: Path) -> None:
    config = from_yaml((tiny_run / "config.yaml").read_text())
    robots, ap = RunFolder(tiny_run).read_weights(config)
    evaluator = Evaluator(config, episodes=3)
    plain = evaluator.play(robots, ap, (0.0, 0.1))
    same = evaluator.play(robots, ap, (0.0, 0.1), serve=lambda _, served: served)
    for one, other in zip(plain, same, strict=True):
        np.testing.assert_array_equal(one.ee, other.ee)


def test_oracles_are_ordered_as_their_freedom_is() -> None:
    evaluator = Evaluator(compose(SMALL), episodes=4)
    found = optimality_gap.shortest_measures(evaluator, 0)
    found[optimality_gap.TRAJECTORY] = optimality_gap.trajectory_measures(evaluator, 2)
    mean = {name: measures.ee.mean() for name, measures in found.items()}
    assert mean[optimality_gap.RANDOM] < mean[optimality_gap.PHASE]
    assert mean[optimality_gap.FIXED] <= mean[optimality_gap.PHASE]
    assert (found[optimality_gap.POWERS].ee >= found[optimality_gap.PHASE].ee - 1e-12).all()
    assert (found[optimality_gap.TRAJECTORY].ee >= found[optimality_gap.POWERS].ee - 1e-12).all()
    assert mean[optimality_gap.TRAJECTORY] > mean[optimality_gap.POWERS]
    assert all((measures.success == 1).all() for measures in found.values())


def test_the_parts_of_the_gap_add_up_and_the_first_two_are_no_loss(tiny_run: Path) -> None:
    config = from_yaml((tiny_run / "config.yaml").read_text())
    evaluator = Evaluator(config, episodes=4)
    found = optimality_gap.policy_measures(evaluator, *RunFolder(tiny_run).read_weights(config))
    assert (found[optimality_gap.POLICY_PHASE].ee >= found[optimality_gap.POLICY].ee - 1e-12).all()
    assert (
        found[optimality_gap.POLICY_POWERS].ee >= found[optimality_gap.POLICY_PHASE].ee - 1e-12
    ).all()
    found[optimality_gap.TRAJECTORY] = optimality_gap.trajectory_measures(evaluator, 0)
    parts = optimality_gap.gap(found, 0)
    assert parts["whole"]["mean"] == sum(parts[name]["mean"] for name in optimality_gap.PARTS)
    difference = found[optimality_gap.TRAJECTORY].ee - found[optimality_gap.POLICY].ee
    assert parts["whole"]["mean"] == pytest.approx(difference.mean(), rel=1e-12)
    for part in parts.values():
        assert part["low"] <= part["mean"] <= part["high"]
    assert optimality_gap.gap(found, 0) == parts
    assert optimality_gap.gap(found, 1) != parts


def test_a_run_is_compared(
    tiny_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "oracle.json"
    options = ["--episodes", "2", "--slack", "0", "--json", str(out)]
    assert main(["oracle", str(tiny_run), *options]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    for word in ("2 held-out episodes", "policy, best phase", "trajectory", "in this order"):
        assert word in printed
    written = json.loads(out.read_text())
    assert set(optimality_gap.STEPS) <= set(written["measures"])
    assert set(written["gap"]) == {*optimality_gap.PARTS, "whole"}
    frozen = tmp_path / "frozen.json"
    assert main(["evaluate", str(tiny_run), "--episodes", "2", "--json", str(frozen)]) == 0
    assert written["measures"]["policy"]["ee"] == json.loads(frozen.read_text())["eps = 0"]["ee"]


def test_it_shows_its_usage(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["oracle", "--help"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("usage: risfleet oracle ")


def test_overrides_are_compared_on_the_starts_of_their_seed(tmp_path: Path) -> None:
    found: list[dict[str, Any]] = []
    for number, seed in enumerate(("5", "5", "6")):
        out = tmp_path / f"{number}.json"
        options = ["--episodes", "2", "--slack", "0", "--seed", seed, "--json", str(out)]
        assert main(["oracle", *SMALL, *options]) == 0
        found.append(json.loads(out.read_text()))
    assert found[0] == found[1]
    assert found[0]["measures"]["trajectory"] != found[2]["measures"]["trajectory"]
    assert "gap" not in found[0]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "is no run folder"),
        (["nowhere", "seed=1"], "allowed is one run folder"),
        (["env.robot=2"], "env.robot"),
        (["env.channel.fading=slot"], "env.channel.fading=slot: allowed is static or none"),
        ([*SMALL, "env.motion.max_slots=3"], "env.motion.max_slots=3: "),
        (["--json", "no/such/file.json"], "--json no/such/file.json: allowed is"),
    ],
)
def test_mistakes_cost_one_sentence(
    arguments: list[str], said: str, refused: Callable[..., str]
) -> None:
    assert said in refused("oracle", *arguments)
