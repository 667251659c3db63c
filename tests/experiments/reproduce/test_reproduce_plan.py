"""Targets of ``risfleet reproduce``: cells that can be trained, and how they become jobs."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from conf import Config
from experiments.batch.states import cost_s, folder_of
from experiments.reproduce.targets import building
from experiments.reproduce.targets.fig3 import OURS
from experiments.reproduce.targets.plan import (
    FRESH_SEEDS,
    SEEDS,
    TARGETS,
    Cell,
    cell_folder,
    configs,
    with_overrides,
)


def target(name: str) -> Any:
    return import_module(f"experiments.reproduce.targets.{name}").TARGET


@cache
def planned(name: str, quick: bool) -> dict[str, dict[int, Config]]:
    """Every run of a target, by its cell and seed."""
    return {cell.name: configs(cell, Path("store")) for cell in target(name).cells(quick)}


def cost_of_all_s(name: str, quick: bool) -> float:
    return sum(cost_s(config) for runs in planned(name, quick).values() for config in runs.values())


@pytest.mark.parametrize(
    ("name", "quick"),
    [
        ("fig3", True),
        ("fig3", False),
        ("optimality", True),
        pytest.param("optimality", False, marks=pytest.mark.slow),
        ("ablations", True),
        pytest.param("ablations", False, marks=pytest.mark.slow),
        pytest.param("bytes", False, marks=pytest.mark.slow),
        pytest.param("airtime", False, marks=pytest.mark.slow),
    ],
)
def test_every_cell_composes_and_differs_from_the_others(name: str, quick: bool) -> None:
    cells = target(name).cells(quick)
    assert target(name).name == name
    assert len({cell.name for cell in cells}) == len(cells)
    folders = {folder_of(c) for runs in planned(name, quick).values() for c in runs.values()}
    assert len(folders) == sum(len(cell.seeds) for cell in cells)


@pytest.mark.parametrize("name", TARGETS)
def test_seeds_on_which_settings_were_chosen_are_not_reported(name: str) -> None:
    own = {"optimality": FRESH_SEEDS, "building": building.SEEDS}
    reported = {*own.get(name, SEEDS)}
    for quick in (True, False):
        assert {seed for cell in target(name).cells(quick) for seed in cell.seeds} <= reported
    assert not reported & {0, 1, 2, 3, 4}


@pytest.mark.parametrize("name", TARGETS)
def test_the_quick_scale_has_cells_of_the_full_one_and_fewer_runs(name: str) -> None:
    quick, full = (target(name).cells(scale) for scale in (True, False))
    assert {cell.name for cell in quick} <= {cell.name for cell in full}
    assert sum(len(cell.seeds) for cell in quick) <= sum(len(cell.seeds) for cell in full) / 3


def test_the_quick_scale_of_fig3_is_a_small_part_of_the_full_one() -> None:
    assert cost_of_all_s("fig3", quick=True) < cost_of_all_s("fig3", quick=False) / 3


def test_cells_of_the_same_configuration_share_their_runs(tmp_path: Path) -> None:
    named = configs(Cell("a", ("env.robots=3", "train.episodes=300"), (10,)), tmp_path)
    default = configs(Cell("b", (), (10, 11)), tmp_path)
    assert named[10] == default[10]
    assert [folder_of(config).name for config in default.values()] == ["seed=10", "seed=11"]


def test_the_users_overrides_stand_above_a_cells_own(tmp_path: Path) -> None:
    cells = with_overrides(target("fig3").cells(quick=True), ["train.episodes=7"])
    ours = next(cell for cell in cells if cell.name == OURS)
    assert configs(ours, tmp_path)[10].train.episodes == 7


def test_runs_of_another_configuration_or_program_lie_elsewhere(
    tiny: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = cell_folder(tiny())
    assert cell_folder(tiny({"seed": 5, "run.dir": "elsewhere"})) == folder
    assert cell_folder(tiny({"train.max_ticks": 90})) != folder
    monkeypatch.setattr(
        "experiments.reproduce.targets.plan.fingerprint", lambda env: "another program"
    )
    assert cell_folder(tiny()) != folder


# --- Costs ----------------------------------------------------------------------------------------


def test_more_episodes_cost_more_and_a_limit_of_ticks_counts(tiny: Any) -> None:
    long, short = (tiny({"train.episodes": n, "train.max_ticks": None}) for n in (30, 10))
    assert cost_s(long) == pytest.approx(3 * cost_s(short))
    assert cost_s(tiny({"train.episodes": 30, "train.max_ticks": 1})) < cost_s(short)


def test_more_worlds_cost_more_a_tick_and_less_an_episode(tiny: Any) -> None:
    one, many = (tiny({"train.worlds": worlds}) for worlds in (1, 64))
    assert cost_s(many) > cost_s(one)
    one, many = (tiny({"train.worlds": n, "train.max_ticks": None}) for n in (1, 64))
    assert cost_s(many) < cost_s(one)
