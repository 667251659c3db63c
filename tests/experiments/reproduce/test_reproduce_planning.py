"""Planned trajectories of ``risfleet reproduce``: worked out once, and kept in a file."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest
from reproduce_helpers import rows_of

from conf import ConfigError, overridden
from experiments.analysis import optimality_gap
from experiments.analysis.optimality_gap import SLACK
from experiments.reproduce.results import planning
from training.evaluation import Evaluator


def test_planned_values_are_the_trajectory_oracles_and_are_kept(
    tiny: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    oma = tiny({"env.access": "oma", "evaluation.episodes": 2})
    again = overridden(oma, ["env.oma.share=reallocate"])
    file = tmp_path / "planned.csv"
    values = planning.planned_values([oma, again, oma], file)
    for config, value in zip((oma, again), values, strict=False):
        expected = optimality_gap.trajectory_measures(Evaluator(config), SLACK).summary()
        assert value._asdict().items() >= {
            (name, expected[name]) for name in ("ee", "sum_rate", "min_rate", "path_ratio")
        }
    assert values[1].ee > values[0].ee == values[2].ee
    monkeypatch.setattr(planning, "_row", lambda config: pytest.fail("was worked out again"))
    assert planning.planned_values([again, oma], file) == [values[1], values[0]]


def test_planned_values_outlast_an_interrupt(
    tiny: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = tiny({"seed": 1}), tiny({"seed": 2})
    work = planning._row

    def interrupted(config: Any) -> Any:
        if config.seed == 2:
            raise KeyboardInterrupt
        return work(config)

    monkeypatch.setattr(planning, "_row", interrupted)
    with pytest.raises(KeyboardInterrupt):
        planning.planned_values([first, second], tmp_path / "planned.csv")
    assert [row["seed"] for row in rows_of(tmp_path / "planned.csv")] == ["1"]


def test_what_agents_see_and_are_paid_changes_no_plan(
    tiny: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, config = tmp_path / "planned.csv", tiny({"evaluation.episodes": 2})
    others = {"env.state.way": "on", "env.state.others": 2, "env.reward.credit": "difference"}
    best = tiny({"evaluation.episodes": 2, **others})
    expected = optimality_gap.trajectory_measures(Evaluator(best), SLACK).summary()
    (value,) = planning.planned_values([config], file)
    assert value.ee == expected["ee"]
    assert value.ee_bits_per_joule == expected["ee_bits_per_joule"]
    monkeypatch.setattr(planning, "_row", lambda config: pytest.fail("was worked out again"))
    assert planning.planned_values([best], file) == [value]


def test_a_file_of_plans_that_lacks_a_measure_is_filled(tiny: Any, tmp_path: Path) -> None:
    file, config = tmp_path / "planned.csv", tiny({"evaluation.episodes": 2})
    whole = planning.planned_values([config], file)
    rows = [{k: v for k, v in row.items() if k != "ee_bits_per_joule"} for row in rows_of(file)]
    with file.open("w", newline="") as text:
        writer = csv.DictWriter(text, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    assert planning.planned_values([config], file) == whole
    assert len(rows_of(file)) == 1


def test_what_cannot_be_planned_is_said_in_a_sentence(tiny: Any, tmp_path: Path) -> None:
    config = tiny({"env.channel.fading": "slot"})
    with pytest.raises(ConfigError, match=r"env\.channel\.fading=slot: allowed is static or none"):
        planning.planned_values([config], tmp_path / "planned.csv")


@pytest.mark.slow
def test_several_processes_plan_what_one_does(
    tiny: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks = [tiny({"seed": seed, "evaluation.episodes": 2}) for seed in (0, 1, 2)]
    alone = planning.planned_values(tasks, tmp_path / "alone.csv")
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    assert planning.planned_values(tasks, tmp_path / "many.csv") == alone
    assert (tmp_path / "many.csv").read_text() == (tmp_path / "alone.csv").read_text()


def test_other_starts_are_planned_anew_and_replace_no_other_line(tiny: Any, tmp_path: Path) -> None:
    file = tmp_path / "planned.csv"
    few = {"evaluation.episodes": 2}
    (one,) = planning.planned_values([tiny(few)], file)
    (other,) = planning.planned_values([tiny(few | {"seed": 1})], file)
    assert one != other
    (walls,) = planning.planned_values([tiny(few | {"env.map_seed": 5})], file)
    assert walls != one
    assert [row["seed"] for row in rows_of(file)] == ["0", "1"]  # the same setting, another map
