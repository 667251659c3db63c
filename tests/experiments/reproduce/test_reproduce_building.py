"""``risfleet reproduce building``: what it trains, and what its table holds."""

from __future__ import annotations

from pathlib import Path

import pytest
from reproduce_helpers import reproduce_quickly, rows_of

from conf import robot_network
from conf.rooms import from_json
from experiments.analysis.optimality_gap import shortest_best_measures
from experiments.reproduce.results.runs import Run
from experiments.reproduce.targets import building
from training.evaluation import Evaluator
from training.preflight import checked_training

SMALL = (
    "agent.hidden=[13,11]",
    "agent.learn_from=8",
    "agent.batch_size=8",
    "train.worlds=2",
    "train.max_ticks=80",
    "evaluation.episodes=2",
    "env.robots=2",
)


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The quick target with short runs of small networks, and two held-out rooms."""
    out: Path = tmp_path_factory.mktemp("building")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(building, "HELD_OUT", 2)
        patch.setattr(building, "ADAPTED", 40)
        reproduce_quickly("building", out, (), *SMALL)
    return out


def test_cells_are_buildings_with_the_same_held_out_rooms(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(building, "HELD_OUT", 2)  # each room's floor is checked
    cells = building.TARGET.cells(quick=False)
    assert len(cells) == 8
    configs = {c.name: checked_training(["runtime=local", *c.overrides]) for c in cells[:2]}
    assert [c.rooms.count for c in configs.values()] == [1, 4]
    assert all(c.rooms.held_out == building.HELD_OUT for c in configs.values())
    (longer,) = (c for c in cells if c.name == building.LONGER)
    config = checked_training(["runtime=local", *longer.overrides])
    assert config.train.max_ticks == 4 * building.TICKS
    assert config.agent.learning_rate_updates == config.train.max_ticks


@pytest.mark.slow
def test_rows_are_what_final_weights_reach_as_shares_of_the_rule(reproduced: Path) -> None:
    found = {row["rooms"]: row for row in rows_of(reproduced / "building_runs.csv")}
    assert list(found) == ["R = 1", "R = 4"]
    runs = [Run(path) for path in sorted(reproduced.glob("runs/*/seed=50"))]
    by_count = {run.config.rooms.count: run for run in runs}
    held_out = [
        [room for room in from_json(run.files.rooms_file.read_text()) if room.held_out]
        for run in runs
    ]
    assert held_out[0] == held_out[1]
    for count, run in by_count.items():
        row, shares, arrived = found[f"R = {count}"], [], []
        for room in held_out[0]:
            place = run.files.room(room.name)
            config = place.read_config()
            evaluator = Evaluator(config)
            (measures,) = evaluator.play(*place.read_weights(config), (0.0,))
            rule = shortest_best_measures(evaluator).summary()["ee"]
            shares.append(measures.summary()["ee"] / rule)
            arrived.append(measures.summary()["success"])
        assert float(row["ee_share"]) == pytest.approx(sum(shares) / 2, rel=1e-5)
        assert float(row["success"]) == pytest.approx(sum(arrived) / 2, rel=1e-5)
        assert float(row["steps"]) == 2 * 80 * count
        weights = robot_network(config).parameters
        assert float(row["megabytes"]) > 2 * 2 * 4 * weights * 2 * count / 1e6
    text = (reproduced / "building.md").read_text()
    assert text.count("| R = ") == 2
    assert (reproduced / "building.png").stat().st_size > 10_000
