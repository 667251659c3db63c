"""``risfleet reproduce optimality``: what it trains, and shares of what plans reach."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from reproduce_helpers import reproduce_quickly, rows_of

from conf import compose
from experiments.analysis import optimality_gap
from experiments.cli import main
from experiments.reproduce.export import collect
from experiments.reproduce.results.runs import Run
from experiments.reproduce.targets import optimality
from experiments.reproduce.targets.optimality import OptimalityOutcome, estimates
from experiments.reproduce.targets.plan import Cell
from training.evaluation import Evaluator
from training.preflight import checked_training

HELPED = (optimality.BEST, optimality.BRANCHING)
LEARNERS = [*HELPED, optimality.PAPER]
STARTS = 2


@pytest.fixture(scope="module")
def reproduced(tiny_overrides: tuple[str, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The quick target on the tiny task, with one of the rivals."""
    out: Path = tmp_path_factory.mktemp("optimality")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(optimality, "STARTS", STARTS)
        patch.setattr(optimality, "HELPED", {name: optimality.HELPED[name] for name in HELPED})
        keys = ("train.max_ticks=40", "train.worlds=2")
        reproduce_quickly("optimality", out, tiny_overrides, *keys)
    return out


def of(robots: int, quick: bool = False) -> list[Cell]:
    return [c for c in optimality.TARGET.cells(quick) if f"env.robots={robots}" in c.overrides]


def test_rivals_learn_with_the_same_help_and_the_paper_with_none() -> None:
    best, *others, paper = (checked_training(["runtime=local", *c.overrides]) for c in of(3))
    for rival in others:
        state = dataclasses.replace(rival.env.state, order=best.env.state.order)
        assert dataclasses.replace(rival.env, state=state) == best.env
        assert (rival.agent, rival.train) == (best.agent, best.train)
        assert rival.scheme.power == best.scheme.power == "search"
        assert rival.strategy.name == "none"
    assert [rival.scheme.agents for rival in others] == ["federated", "branching", "centralized"]
    assert best.strategy.name != "none"
    assert paper == compose(["runtime=local"])
    assert [cell.name.split(",")[0] for cell in of(6)] == ["best", "the paper's settings"]


def test_measures_are_shares_of_the_plans_from_the_same_starts(reproduced: Path) -> None:
    found = {row["learner"]: row for row in rows_of(reproduced / "optimality_runs.csv")}
    assert list(found) == [*LEARNERS, optimality.RULE]
    runs = [Run(path) for path in reproduced.glob("runs/*/seed=40")]
    searched = [run for run in runs if run.config.scheme.power == "search"]
    (run,) = (run for run in searched if run.config.strategy.name != "none")
    (paper,) = (run for run in runs if run not in searched)
    evaluator = Evaluator(run.config, episodes=STARTS)
    plans = optimality_gap.trajectory_measures(evaluator, optimality_gap.SLACK).summary()
    (played,) = evaluator.play(*run.weights(), (0.0,))
    best = found[optimality.BEST]
    share = played.summary()["ee"] / plans["ee"]
    assert float(best["ee_share"]) == pytest.approx(share, rel=1e-5)
    assert float(best["cpu_s"]) == pytest.approx(run.summary["cpu_s"], rel=1e-5)
    rule = optimality_gap.shortest_measures(evaluator, 40)[optimality_gap.POWERS].summary()
    bits = rule["ee_bits_per_joule"] / plans["ee_bits_per_joule"]
    assert float(found[optimality.RULE]["bits_share"]) == pytest.approx(bits, rel=1e-5)
    assert found[optimality.RULE]["success"] == "1"
    of_paper = Evaluator(paper.config, episodes=STARTS)
    np.testing.assert_array_equal(evaluator.starts, of_paper.starts)


def test_tables_have_a_row_for_each_learner_and_the_rule(reproduced: Path) -> None:
    table = (reproduced / "optimality.md").read_text()
    for learner in (*LEARNERS, optimality.RULE):
        assert table.count(f"| 3 | {learner} | ") == 1
    assert f"from {STARTS} held-out starts" in table
    assert "Quick: few seeds" in table
    numbers = rows_of(reproduced / "optimality.csv")
    assert len(numbers) == 4 * 6
    assert {row["seeds"] for row in numbers} <= {"0", "1"}


def test_weights_of_the_best_are_exported(reproduced: Path, tmp_path: Path) -> None:
    results = tmp_path / "results"
    assert collect.main([str(reproduced), str(results)]) == 0
    folder = results / "weights" / "k3-best"
    assert main(["evaluate", str(folder), "--episodes", "1"]) == 0
    card = (results / "weights" / "README.md").read_text()
    assert "Powers are picked by the access point, which searches them in each slot (k3-best)" in (
        " ".join(card.split())
    )


def outcome(learner: str, seed: int, share: float) -> OptimalityOutcome:
    return OptimalityOutcome(2, learner, seed, 1.0, share, 1.0, share, 1.0, 1.0, 2.0)


def test_a_learner_is_compared_with_the_best_seed_by_seed() -> None:
    found = [outcome(optimality.BEST, seed, 0.9 - seed / 100) for seed in (0, 1, 2)]
    found += [outcome("rival", seed, 0.8 - seed / 100) for seed in (2, 1, 0)]
    made = estimates(found)
    above = made[2, "rival"]["above_best"]
    assert (above.value, above.low, above.high) == pytest.approx((-0.1, -0.1, -0.1))
    assert made[2, optimality.BEST]["ee_share"].value == pytest.approx(0.89)
    assert made[2, "rival"]["ee_share"].low < made[2, "rival"]["ee_share"].high
