"""``risfleet reproduce fig4``, ``fig5``: which runs they need, and what they make of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from reproduce_helpers import measure_shortly, rows_of, same_run

from conf import compose, overridden
from env.oracles.trajectory import best_trajectory
from experiments.analysis import played as along
from experiments.analysis.optimality_gap import SLACK
from experiments.analysis.played import PlayedEpisodes
from experiments.reproduce.results.runs import Run, Runs
from experiments.reproduce.targets import claims, fig3, fig4, fig5
from experiments.reproduce.targets.fig4_drawing import draw
from experiments.reproduce.targets.fig4_points import (
    BEST,
    LEARNED,
    PLANNED,
    PLANNED_AGAIN,
    PointOutcome,
    neighbours,
    points,
)
from experiments.reproduce.targets.fig5_drawing import Shown, draw_along, draw_ways
from experiments.reproduce.targets.plan import COMMON, Cell, cell_folder, configs, with_overrides
from experiments.runtimes import local
from training.evaluation import Evaluator
from training.preflight import checked_training
from training.run_folder import RunFolder
from training.trace import Trace

OWN = ("runtime", "run.", "env.ris.side")
"""Keys of the tiny task that cells set."""


def trained(cells: Sequence[Cell], tiny: Sequence[str], store: Path) -> Runs:
    """Trains every run of the cells on the tiny task."""
    keys = [key for key in tiny if not key.startswith(OWN)] + [
        "train.max_ticks=40",
        "train.worlds=2",
    ]
    runs: dict[str, dict[int, Run]] = {}
    for cell in with_overrides(cells, keys):
        runs[cell.name] = {}
        for seed, config in configs(cell, store).items():
            local.train(config, RunFolder.of(config))
            runs[cell.name][seed] = Run(Path(str(config.run.dir)))
    return runs


@pytest.fixture(scope="module")
def few_points() -> Iterator[None]:
    """Quick figures have one M_R and one power budget."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fig4, "QUICK_SIDES", (30,))
        patch.setattr(fig4, "QUICK_POWERS_DBM", (10,))
        patch.setattr(fig5, "QUICK_SIDES", (30,))
        yield


@pytest.fixture(scope="module")
def runs_of_fig4(
    few_points: None, tiny_overrides: Sequence[str], tmp_path_factory: pytest.TempPathFactory
) -> Runs:
    return trained(fig4.TARGET.cells(True), tiny_overrides, tmp_path_factory.mktemp("fig4"))


@pytest.fixture(scope="module")
def runs_of_fig5(
    few_points: None, tiny_overrides: Sequence[str], tmp_path_factory: pytest.TempPathFactory
) -> Runs:
    return trained(fig5.TARGET.cells(True), tiny_overrides, tmp_path_factory.mktemp("fig5"))


def check_pictures(files: Sequence[Path], names: Sequence[str]) -> None:
    """Every picture is there in both forms, and has something on it."""
    for name in names:
        (png,) = (file for file in files if file.name == f"{name}.png")
        assert png.read_bytes().startswith(b"\x89PNG")
        assert "</svg>" in png.with_suffix(".svg").read_text()


@pytest.mark.parametrize(("target", "quick", "full"), [(fig4, 18, 210), (fig5, 4, 24)])
def test_no_figure_trains_a_configuration_twice(target: Any, quick: int, full: int) -> None:
    for small, count in ((True, quick), (False, full)):
        cells = target.TARGET.cells(small)
        assert sum(len(cell.seeds) for cell in cells) == count
        assert len({cell.name for cell in cells}) == len(cells)
        assert len({cell.overrides for cell in cells}) == len(cells)


def test_cells_are_configurations_that_can_be_trained() -> None:
    of_fig4 = fig4.TARGET.cells(True)
    cells = [of_fig4[0], of_fig4[6], fig4.TARGET.cells(False)[-1], fig5.TARGET.cells(False)[-1]]
    best, first, last, qoe = (checked_training([*COMMON, *cell.overrides]) for cell in cells)
    assert best.scheme.power == "search"
    assert (best.env.ris.side, best.env.power.max_dbm, best.env.access) == (30, 10.0, "noma")
    assert (best.train.max_ticks, best.evaluation.episodes) == (1000, 20)
    assert (first.env.ris.side, first.env.power.max_dbm, first.env.access) == (0, 10.0, "noma")
    assert (first.train.episodes, first.evaluation.episodes) == (150, 20)
    env = last.env
    assert (env.robots, env.ris.side, env.power.max_dbm, env.access) == (4, 30, 30.0, "oma")
    assert (env.oma.share, env.metric, last.train.episodes) == ("fixed", "qos", 300)
    assert (qoe.env.robots, qoe.env.ris.side, qoe.env.metric) == (3, 40, "qoe")


def test_figures_share_the_runs_that_both_need() -> None:
    both: list[Any] = [fig4.Fig4Setting(3, 30, 20, "noma"), fig5.Fig5Setting(30, "qos")]
    folders = {cell_folder(checked_training([*COMMON, *each.overrides])) for each in both}
    assert folders == {cell_folder(checked_training(COMMON))}


def test_fig_4_has_a_point_for_each_setting_and_curve(runs_of_fig4: Runs, tmp_path: Path) -> None:
    files = fig4.TARGET.report(runs_of_fig4, tmp_path, quick=True)
    assert all(file.is_file() for file in files)
    check_pictures(files, ["fig4"])
    drawn = rows_of(tmp_path / "fig4.csv")
    assert len(drawn) == 7  # curves
    assert {(row["access"], row["curve"]) for row in drawn} == {
        *(("noma", curve) for curve in (LEARNED, BEST, PLANNED)),
        *(("oma", curve) for curve in (LEARNED, BEST, PLANNED, PLANNED_AGAIN)),
    }
    runs = rows_of(tmp_path / "fig4_runs.csv")
    assert len(runs) == len(drawn)
    name = fig4.Fig4Setting(3, 30, 10, "oma").name
    last = runs_of_fig4[name][10].summary["evaluation"]["last5"]
    (row,) = (row for row in runs if list(row.values())[:5] == ["3", "30", "10", "oma", LEARNED])
    assert float(row["ee"]) == pytest.approx(last["ee"], rel=1e-5)
    assert float(row["success"]) == pytest.approx(last["success"], rel=1e-5)
    final = runs_of_fig4[fig4.Fig4Setting(3, 30, 10, "oma").best][10].summary["evaluation"]["eps05"]
    (row,) = (row for row in runs if list(row.values())[:5] == ["3", "30", "10", "oma", BEST])
    assert float(row["ee"]) == pytest.approx(final["ee"], rel=1e-5)
    assert len((tmp_path / "fig4.md").read_text().splitlines()) == 2 + 7 + 2


def outcome(ee: float, seed: int = 0, success: float = 1.0, **of: Any) -> PointOutcome:
    given = {"robots": 3, "side": 20, "max_dbm": 20, "access": "noma", "curve": LEARNED} | of
    return PointOutcome(**given, seed=seed, ee=ee, success=success, sum_rate=1.0, min_rate=0.1)


def test_points_where_few_robots_arrive_are_hollow() -> None:
    found = [outcome(0.1, max_dbm=10, success=0.95), outcome(0.1, max_dbm=20, success=0.85)]
    figure = draw(points(found), "")
    marks = [line for line in figure.axes[0].lines if line.get_marker() == "o"]
    faces = {float(np.asarray(line.get_xdata())[0]): line.get_markerfacecolor() for line in marks}
    assert faces[20.0] == "white"
    assert faces[10.0] != "white"
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "fewer than 90 % arrive" in labels
    assert "OMA, learned" not in labels


def test_points_are_means_over_seeds_inside_their_intervals() -> None:
    (point,) = points([outcome(ee, seed, ee) for seed, ee in enumerate((0.1, 0.2, 0.6))])
    assert point.ee == pytest.approx(0.3)
    assert point.success == pytest.approx(0.3)
    assert 0.1 <= point.low < point.ee < point.high <= 0.6
    (alone,) = points([outcome(0.1)])
    assert alone.ee == 0.1
    assert np.isnan([alone.low, alone.high]).all()


def test_comparisons_pair_seeds_and_take_the_next_smaller_neighbour() -> None:
    found = [outcome(ee, seed) for seed, ee in enumerate((0.2, 0.3))]
    found += [
        outcome(ee, seed, 0.8, access="oma") for seed, ee in reversed([*enumerate((0.1, 0.2))])
    ]
    found += [outcome(0.1, seed, side=side) for seed in (0, 1) for side in (0, 10)]
    made = {(each.what, each.side): each for each in neighbours(found) if each.access == "noma"}
    assert set(made) == {
        ("NOMA over OMA", 20),
        ("M_R = 20 over 10", 20),
        ("M_R = 10 over 0", 10),
    }
    nomas = made["NOMA over OMA", 20]
    assert nomas.percent == pytest.approx(75.0)
    assert (nomas.seeds, nomas.least_success) == (2, pytest.approx(0.8))
    assert made["M_R = 20 over 10", 20].percent == pytest.approx(150.0)


def test_the_best_is_compared_with_the_defaults_and_drawn_with_its_own_mark() -> None:
    found = [outcome(0.1), outcome(0.15, curve=BEST)]
    (made,) = neighbours(found)
    assert (made.what, made.curve) == ("best over the defaults", BEST)
    assert made.percent == pytest.approx(50.0)
    figure = draw(points(found), "")
    assert {"NOMA, learned", "NOMA, learned, best"} == {
        text.get_text() for text in figure.legends[0].get_texts()
    }
    marks = {line.get_marker(): line.get_color() for line in figure.axes[0].lines}
    assert marks["o"] != marks["^"]


def test_robots_of_fig_5_start_opposite_their_destinations() -> None:
    evaluator = along.mirrored(compose([]))
    world = evaluator.world
    centres = world.floor.centres()
    np.testing.assert_allclose(
        centres[evaluator.starts[0]], [[2.75, 17.75], [25.75, 19.75], [7.75, 27.75]]
    )
    np.testing.assert_allclose(
        centres[evaluator.starts[0]] + centres[world.destinations], np.full((3, 2), 30.0)
    )
    assert world.slots_to_go[evaluator.starts[0], range(3)].tolist() == [60, 62, 80]


def test_what_is_seen_along_the_way_is_what_is_measured(runs_of_fig5: Runs) -> None:
    run = fig5.first(runs_of_fig5[fig5.Fig5Setting(30, "qos").name])
    trace = Trace()
    evaluator = Evaluator(run.config)
    (played,) = evaluator.play(*run.weights(), (0.05,), trace.see)
    trace.finish(evaluator.world)
    drive = along.learned(Evaluator(run.config), run.weights(), 0.05)
    np.testing.assert_array_equal(drive.measures.ee, played.ee)
    np.testing.assert_array_equal(drive.ways_m, trace.ways_m(evaluator.world))
    slots = np.isfinite(drive.along.rate).any(axis=-1).sum(axis=0)
    sums = np.nansum(drive.along.rate, axis=(0, 2))
    np.testing.assert_allclose(sums / slots, played.sum_rate)
    assert drive.gain_db == pytest.approx(np.nanmean(drive.along.gain_db))


def test_a_planned_drive_is_worth_what_its_plan_says(tiny: Any) -> None:
    evaluator = along.mirrored(tiny())
    drive = along.planned(evaluator)
    plan = best_trajectory(evaluator.world, evaluator.starts[0], SLACK)
    assert drive.measures.ee[0] == pytest.approx(plan.value, rel=1e-12)
    assert drive.measures.success[0] == 1.0
    np.testing.assert_array_equal(drive.ways_m[-1, 0], drive.destinations_m)


def test_fig_5_writes_every_slot_and_every_measure(runs_of_fig5: Runs, tmp_path: Path) -> None:
    files = fig5.TARGET.report(runs_of_fig5, tmp_path, quick=True)
    assert all(file.is_file() for file in files)
    check_pictures(files, ["fig5", "fig5_along", "fig5_planned", "fig5_planned_along"])
    measures = rows_of(tmp_path / "fig5_measures.csv")
    assert len(measures) == 2 * 4  # QoS and QoE, learned and planned, both kinds of starts
    kinds = {(row["policy"], row["starts"]) for row in measures}
    assert len(kinds) == 4
    slots = rows_of(tmp_path / "fig5.csv")
    for setting in fig5.settings(True):
        for policy in (LEARNED, PLANNED):
            of = [
                row
                for row in slots
                if (row["side"], row["metric"], row["policy"])
                == (str(setting.side), setting.metric, policy)
            ]
            assert {row["robot"] for row in of} == {"0", "1", "2"}
            assert all(float(row["rate"]) >= 0 for row in of)


def test_a_robot_that_does_not_arrive_is_crossed(tiny: Any) -> None:
    evaluator = along.mirrored(tiny())
    there = along.planned(evaluator)
    stuck = along.planned(along.mirrored(tiny()))
    stuck.along.cells[-1] = evaluator.starts

    def crosses(axes: Axes) -> int:
        return sum(line.get_marker() == "X" for line in axes.lines)

    def shown(qoe: PlayedEpisodes) -> list[Shown]:
        drives = {"qos": there, "qoe": qoe}
        return [Shown(4, metric, PLANNED, None, drive) for metric, drive in drives.items()]

    arrives, misses = (draw_ways(shown(qoe), "") for qoe in (there, stuck))
    assert crosses(arrives.axes[0]) == 0
    assert crosses(misses.axes[0]) == 3
    lines = draw_along(shown(stuck), "").axes
    assert [len(axes.lines) for axes in lines] == [6, 6]


def test_every_claim_and_every_check_is_written(
    runs_of_fig4: Runs,
    runs_of_fig5: Runs,
    tiny_run: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    measure_shortly(monkeypatch)
    of_fig3 = same_run(fig3.TARGET, tiny_run)
    central = Run(tiny_run)
    keys = ["scheme.agents=centralized", "strategy.name=none"]
    vars(central)["config"] = overridden(central.config, keys)  # in the place of what it caches
    runs = {**of_fig3, fig3.CENTRALIZED: {0: central}, **runs_of_fig4, **runs_of_fig5}
    claims.TARGET.report(runs, tmp_path, quick=True)
    found = {row["claim"]: row["verdict"] for row in rows_of(tmp_path / "claims.csv")}
    kinds = {verdict.split(" on ")[0] for verdict in found.values()}
    assert kinds <= {"holds", "does not hold", "depends", "not shown"}
    assert found["F-DRL significantly reduces the communication overhead"] == "does not hold"
    assert {row["claim"] for row in rows_of(tmp_path / "claims_checks.csv")} == set(found)
    table = (tmp_path / "claims.md").read_text()
    assert all(f"| {says} |" in table for says in found)
    widths = {line.count("|") for line in table.splitlines() if line.startswith("|")}
    assert len(widths) == 1
