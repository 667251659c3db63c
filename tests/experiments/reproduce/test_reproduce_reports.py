"""What targets of ``risfleet reproduce`` write, from runs of a tiny task."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from reproduce_helpers import reproduce_quickly, rows_of, same_run

from experiments.reproduce.results.output import save_figure
from experiments.reproduce.results.runs import Run
from experiments.reproduce.targets import ablations, fig3
from storage.checkpoint_files import digest
from training.recording.figures import running_mean


def test_a_run_is_read_as_it_was_written(tiny_run: Path) -> None:
    run = Run(tiny_run)
    assert (run.seed, run.config.env.robots) == (0, 3)
    assert len(run.metrics()["reward"]) == run.summary["episodes"]
    assert set(run.evaluations()["epsilon"]) == {0.05}
    robots, ap = run.weights()
    assert robots.shape[0] == 3
    assert ap.ndim == 1


def test_fig3_writes_its_curves_and_tables(tiny_run: Path, tmp_path: Path) -> None:
    files = fig3.TARGET.report(same_run(fig3.TARGET, tiny_run, (0, 1)), tmp_path, quick=True)
    assert {path.name for path in files} == {path.name for path in tmp_path.iterdir()}
    assert {"fig3.png", "fig3.svg", "fig3.csv", "fig3_convergence.md"} <= {p.name for p in files}
    assert (tmp_path / "fig3.png").read_bytes()[:4] == b"\x89PNG"
    reward = running_mean(Run(tiny_run).metrics()["reward"], fig3.SMOOTHING)
    ours = [row for row in rows_of(tmp_path / "fig3.csv") if row["cell"] == fig3.OURS]
    for key in ("mean", "low", "high"):  # two equal runs: no width
        assert [float(row[key]) for row in ours] == pytest.approx(reward, rel=1e-5)
    assert len(rows_of(tmp_path / "fig3_runs.csv")) == 2 * len(fig3.TARGET.cells(quick=True))
    table = (tmp_path / "fig3_convergence.md").read_text()
    assert f"| {fig3.OURS} | " in table


def figure_bytes(out: Path, *, quick: bool) -> list[bytes]:
    figure = Figure()
    figure.subplots().plot([1, 2])
    out.mkdir(exist_ok=True)
    return [path.read_bytes() for path in save_figure(figure, out, "figure", quick=quick)]


def test_a_figure_is_the_same_bytes_each_time(tmp_path: Path) -> None:
    assert figure_bytes(tmp_path, quick=False) == figure_bytes(tmp_path, quick=False)


def test_a_quick_figure_says_so(tmp_path: Path) -> None:
    quick, full = figure_bytes(tmp_path, quick=True), figure_bytes(tmp_path, quick=False)
    assert b"<!-- quick: few seeds" in quick[1]
    assert b"quick" not in full[1]


def test_ablations_are_differences_from_the_default(tiny_run: Path, tmp_path: Path) -> None:
    runs = same_run(ablations.TARGET, tiny_run, (0, 1))
    files = ablations.TARGET.report(runs, tmp_path, quick=True)
    assert {path.name for path in files} == {path.name for path in tmp_path.iterdir()}
    found = rows_of(tmp_path / "ablations.csv")
    deltas = [row for row in found if row["measure"] == "ee_difference"]
    assert len(deltas) == len(ablations.TARGET.cells(quick=True))
    assert {float(row["value"]) for row in deltas} == {0.0}
    ee = Run(tiny_run).summary["evaluation"]["last5"]["ee"]
    values = [float(row["value"]) for row in found if row["measure"] == "ee"]
    assert values == pytest.approx([ee] * len(deltas), rel=1e-5)
    assert "| default" not in (tmp_path / "ablations.md").read_text()
    assert "`default`" in (tmp_path / "ablations.md").read_text()


@pytest.mark.slow
def test_the_command_trains_reports_and_says_what_it_came_from(
    tiny_overrides: tuple[str, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    reproduce_quickly("fig3", out, tiny_overrides, "train.max_ticks=40")
    printed = capsys.readouterr().out
    assert "10 runs to train, 0 done before" in printed
    manifest = json.loads((out / "fig3.manifest.json").read_text())
    assert (manifest["target"], manifest["quick"]) == ("fig3", True)
    assert "train.max_ticks=40" in manifest["overrides"]
    for name, found in manifest["files"].items():
        assert hashlib.sha256((out / name).read_bytes()).hexdigest() == found
    cells = {cell.name for cell in fig3.TARGET.cells(quick=True)}
    assert set(manifest["cells"]) == cells
    seed = manifest["cells"][fig3.OURS]["seeds"]["10"]
    run = Run(out / seed["folder"])
    assert run.summary["digest"] == seed["digest"]


def test_weights_in_a_run_are_those_of_its_digest(tiny_run: Path) -> None:
    from safetensors.numpy import load_file

    whole = load_file(tiny_run / "weights.safetensors")
    assert digest(whole["robots"]) == Run(tiny_run).summary["digest"]["robots"]
    assert np.array_equal(whole["robots"][:, 0], Run(tiny_run).weights()[0])
