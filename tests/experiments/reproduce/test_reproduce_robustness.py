"""``risfleet reproduce losses`` and ``attacks``: what they train, and what their tables hold."""

from __future__ import annotations

from pathlib import Path

import pytest

from conf import compose
from experiments.cli import main
from experiments.reproduce.targets import attacks, losses

SMALL = (
    *("train.max_ticks=60", "train.episodes=100000", "agent.hidden=[5]", "evaluation.every=1"),
    *("evaluation.episodes=1", "env.motion.max_slots=25", "state.every=null"),
)


@pytest.mark.slow
def test_every_setting_of_both_targets_is_allowed_and_another() -> None:
    for target in (losses.TARGET, attacks.TARGET):
        configs = [compose([*cell.overrides]) for cell in target.cells(quick=False)]
        assert all(one != other for i, one in enumerate(configs) for other in configs[:i])


def test_attacks_are_of_one_of_four_and_two_of_six_and_within_a_rules_bound_one_of_seven() -> None:
    cells = attacks.TARGET.cells(quick=False)
    given = [dict(each.split("=") for each in cell.overrides) for cell in cells]
    hostile = [
        (each["env.robots"], each["attack.robots"]) for each in given if "attack.robots" in each
    ]
    assert {*hostile} == {("4", "1"), ("6", "2"), ("7", "1")}
    bulyan = [each for each in given if each["strategy"] == "bulyan"]
    found = [(each["env.robots"], each["strategy.malicious"], each["attack"]) for each in bulyan]
    assert found == [("7", "1", "none"), ("7", "1", "flip")]


@pytest.mark.slow
def test_the_table_of_attacks_has_a_cell_for_each_run_that_was_made(tmp_path: Path) -> None:
    command = ["reproduce", "attacks", "--quick", "--out", str(tmp_path), "hydra/launcher=basic"]
    assert main([*command, *SMALL]) == 0
    table = (tmp_path / "attacks.md").read_text().splitlines()
    firsts = [line.split(" | ")[0] for line in table[2:4]]
    assert firsts == ["| K = 4, none", "| K = 4, 1 hostile: flip"]
    assert table[3].count("0.") == 2
    assert table[3].count("| -") == len(attacks.RULES) - 2
