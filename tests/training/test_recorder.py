"""What a run leaves in its folder, and what it says of itself while it lasts."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from safetensors.numpy import load_file

from conf import Config, from_yaml
from env.world import World
from experiments.runtimes import local
from storage.atomic import write_atomically
from storage.checkpoint_files import digest
from storage.strict_json import to_json
from training.recording.history import EVALUATIONS, MEASURES, METRICS, History
from training.recording.progress import Progress
from training.recording.recorder import Recorder
from training.run_folder import RunFolder
from training.session import TrainingRun

Tiny = Callable[..., Config]
KEYS = ("ticks", "windows", "episodes", "wall_s", "steps_per_s", "flower_share", "seed", "cpu_s")


def strict_json(path: Path) -> Any:
    """A file as JSON, without the numbers that only Python takes."""

    def refuse(text: str) -> None:
        raise AssertionError(f"{text} is not JSON")

    return json.loads(path.read_text(), parse_constant=refuse)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def trained(tiny: Tiny, folder: Path, changes: dict[str, Any] | None = None) -> dict[str, Any]:
    return local.train(tiny({"run.dir": str(folder), **(changes or {})}), RunFolder(folder))


# --- The folder -----------------------------------------------------------------------------------


def test_the_configuration_that_is_written_reads_back_as_it_was(tiny: Tiny, tmp_path: Path) -> None:
    changes = {"seed": 5, "agent.target.tau": 0.25, "federation.clients": 2, "train.max_ticks": 10}
    trained(tiny, tmp_path / "run", changes)
    expected = tiny({"run.dir": str(tmp_path / "run"), **changes})
    assert from_yaml((tmp_path / "run" / "config.yaml").read_text()) == expected


def test_summary_is_strict_json_with_the_names_that_others_rely_on(tiny_run: Path) -> None:
    summary = strict_json(tiny_run / "summary.json")
    assert all(isinstance(summary[key], int | float) for key in KEYS)
    assert (summary["ticks"], summary["windows"], summary["stopped_early"]) == (100, 10, False)
    assert summary["flower_share"] == 0
    assert summary["steps_per_s"] > 0
    assert set(summary["versions"]) >= {"risfleet", "torch", "numpy", "flwr"}
    for kind in ("greedy", "eps05", "last5"):
        assert set(summary["evaluation"][kind]) == set(MEASURES)
        for name, value in summary["evaluation"][kind].items():
            assert value is None or math.isfinite(value), name


def test_summary_names_the_digests_of_the_weights_beside_it(tiny_run: Path) -> None:
    found = strict_json(tiny_run / "summary.json")["digest"]
    arrays = load_file(tiny_run / "weights.safetensors")
    assert {name: digest(arrays[name]) for name in ("robots", "ap")} == found
    assert all(array.dtype == np.float32 for array in arrays.values())
    assert arrays["robots"].shape[:2] == (3, 2)
    assert arrays["ap"].shape[0] == 2


def test_metrics_have_a_row_for_each_episode(tiny_run: Path) -> None:
    found = rows(tiny_run / "metrics.csv")
    summary = strict_json(tiny_run / "summary.json")
    assert tuple(found[0]) == METRICS
    assert [int(row["episode"]) for row in found] == list(range(1, summary["episodes"] + 1))
    ticks = [int(row["tick"]) for row in found]
    slots = [float(row["slots"]) for row in found]
    assert np.diff([0, *ticks]).tolist() == slots
    assert 0 < ticks[-1] <= 100
    assert float(found[0]["epsilon"]) > float(found[-1]["epsilon"])


def test_evaluations_have_two_rows_for_each_that_was_due(tiny_run: Path) -> None:
    found = rows(tiny_run / "evaluations.csv")
    episodes = strict_json(tiny_run / "summary.json")["episodes"]
    assert tuple(found[0]) == EVALUATIONS
    assert [float(row["epsilon"]) for row in found] == [0.05, 0.0] * (len(found) // 2)
    assert 1 <= len(found) // 2 <= episodes // 2
    for explored, greedy in zip(found[::2], found[1::2], strict=True):
        for key in ("episode", "tick", "path_ratio"):
            assert explored[key] == greedy[key]
        assert int(explored["tick"]) % 10 == 0
        assert int(explored["episode"]) >= 2


def test_figures_are_images_that_show_something(tiny_run: Path) -> None:
    found = sorted((tiny_run / "figures").glob("*.png"))
    assert [path.name for path in found] == ["learning_curve.png", "trajectories.png"]
    for path in found:
        pixels = matplotlib.image.imread(path)
        assert min(pixels.shape[:2]) > 300
        assert pixels[..., :3].std() > 0.01


def test_events_hold_what_the_metrics_hold(tiny_run: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(tiny_run / "tensorboard"))
    events.Reload()
    logged = [(event.step, event.value) for event in events.Scalars("train/success")]
    assert len(logged) == len(rows(tiny_run / "metrics.csv"))
    for (tick, value), row in zip(logged, rows(tiny_run / "metrics.csv"), strict=True):
        assert tick == int(row["tick"])
        assert value == pytest.approx(float(row["success"]))
    assert "evaluation/success" in events.Tags()["scalars"]


def test_figures_and_events_can_be_left_out(tiny: Tiny, tmp_path: Path) -> None:
    trained(tiny, tmp_path, {"train.max_ticks": 10})
    assert not (tmp_path / "figures").exists()
    assert not (tmp_path / "tensorboard").exists()


def test_a_run_without_a_finished_episode_is_whole_all_the_same(tiny: Tiny, tmp_path: Path) -> None:
    changes = {"train.max_ticks": 1, "federation.every": 1, "run.figures": True}
    trained(tiny, tmp_path, changes)
    summary = strict_json(tmp_path / "summary.json")
    assert (summary["ticks"], summary["episodes"], summary["converged"]) == (1, 0, None)
    assert set(summary["evaluation"]["last5"].values()) == {None}
    assert rows(tmp_path / "metrics.csv") == rows(tmp_path / "evaluations.csv") == []
    assert len(list((tmp_path / "figures").glob("*.png"))) == 2


def test_a_run_leaves_no_temporary_files(tiny_run: Path) -> None:
    names = {path.name for path in tiny_run.iterdir()}
    assert names == {
        "config.yaml",
        "episode.json",
        "evaluations.csv",
        "figures",
        "metrics.csv",
        "progress.json",
        "state",
        "summary.json",
        "tensorboard",
        "weights.safetensors",
    }


def test_numbers_that_json_lacks_become_null() -> None:
    values = {"a": float("nan"), "b": {"c": float("inf"), "d": 1.5}, "e": np.float64("nan")}
    assert json.loads(to_json(values)) == {"a": None, "b": {"c": None, "d": 1.5}, "e": None}


# --- Convergence and means ------------------------------------------------------------------------


def history(*successes: float) -> History:
    found = [
        {"episode": 10.0 * n, "tick": 750.0 * n, "cpu_s": 2.0 * n, **dict.fromkeys(MEASURES, value)}
        for n, value in enumerate(successes, start=1)
    ]
    return History(evaluations=found, greedy=[])


@pytest.mark.parametrize(
    ("successes", "episode"),
    [
        ((0.9, 0.9, 0.9), 10),
        ((0.5, 1.0, 1.0, 0.89, 0.95, 0.9, 1.0), 50),
        ((1.0, 1.0), None),
        ((1.0, 1.0, 0.8, 1.0, 1.0), None),
        ((), None),
    ],
)
def test_convergence_is_the_first_of_three_good_evaluations_in_a_row(
    successes: tuple[float, ...], episode: int | None
) -> None:
    found = history(*successes).converged()
    if episode is None:
        assert found is None
    else:
        assert found == {"episode": episode, "tick": 75 * episode, "cpu_s": episode / 5}


def test_the_last_evaluations_are_averaged_measure_by_measure() -> None:
    kept = history(1.0, 0.2, 0.4, 0.6, 0.8, 1.0)
    assert kept.last(5)["success"] == pytest.approx(0.6)
    assert history(0.5).last(5)["ee"] == 0.5
    kept.evaluations[-1]["path_ratio"] = float("nan")
    assert kept.last(5)["path_ratio"] == pytest.approx(0.5)
    assert all(math.isnan(value) for value in history().last(5).values())


def test_summary_holds_the_mean_of_the_last_five_evaluations(tiny_run: Path) -> None:
    explored = rows(tiny_run / "evaluations.csv")[::2][-5:]
    last = strict_json(tiny_run / "summary.json")["evaluation"]["last5"]
    for name in set(MEASURES) - {"path_ratio"}:
        assert last[name] == pytest.approx(np.mean([float(row[name]) for row in explored]))


# --- Progress -------------------------------------------------------------------------------------


def spied_states(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    seen: list[str] = []
    report = Recorder.report

    def spy(self: Recorder, state: str, progress: Progress, message: str = "") -> None:
        report(self, state, progress, message)
        status = self.folder.read_progress()
        assert status is not None
        seen.append(status["state"])

    monkeypatch.setattr(Recorder, "report", spy)
    return seen


def test_progress_goes_from_starting_to_done(
    tiny: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = spied_states(monkeypatch)
    monkeypatch.setattr("training.recording.recorder.PROGRESS_PERIOD_S", 0.0)
    trained(tiny, tmp_path, {"train.max_ticks": 30})
    assert seen == ["starting", "training", "training", "training", "finishing", "done"]
    status = strict_json(tmp_path / "progress.json")
    assert (status["tick"], status["window"], status["max_ticks"]) == (30, 3, 30)


def test_a_run_that_fails_says_so_with_its_reason(
    tiny: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step, calls = World.step, iter(range(100))

    def breaking(self: World, *chosen: Any) -> Any:
        if next(calls) == 15:
            raise ArithmeticError("weights are not finite")
        return step(self, *chosen)

    monkeypatch.setattr(World, "step", breaking)
    with pytest.raises(ArithmeticError, match="not finite"):
        trained(tiny, tmp_path, {"evaluation.every": 1000})
    status = strict_json(tmp_path / "progress.json")
    assert (status["state"], status["tick"], status["window"]) == ("failed", 15, 2)
    assert "weights are not finite" in status["message"]
    assert not (tmp_path / "summary.json").exists()
    assert not (tmp_path / "weights.safetensors").exists()


# --- Who only watches -----------------------------------------------------------------------------


def test_a_run_whose_progress_cannot_be_written_goes_on_and_says_so_once(
    tiny: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    length = {"train.max_ticks": 30}
    expected = trained(tiny, tmp_path / "undisturbed", length)["digest"]
    monkeypatch.setattr("training.recording.recorder.PROGRESS_PERIOD_S", 0.0)
    refused = []

    def refuse(folder: RunFolder, status: object) -> None:
        refused.append(status)
        raise OSError(28, "No space left on device", str(folder.progress_file))

    monkeypatch.setattr(RunFolder, "write_progress", refuse)
    assert trained(tiny, tmp_path / "run", length)["digest"] == expected
    assert len(refused) > 2
    (said,) = caplog.messages
    assert said == "progress.json is not written: No space left on device"


class Events:
    """Events whose file cannot be written, from the moment that is named on."""

    def __init__(self, breaks: str) -> None:
        self.breaks = breaks

    def add_scalar(self, *_: Any) -> None:
        """Adds nothing."""
        if self.breaks == "writing":
            raise OSError(28, "No space left on device")

    def close(self) -> None:
        """Closes nothing."""
        raise OSError(28, "No space left on device")


@pytest.mark.parametrize("breaks", ["opening", "writing", "closing"])
def test_a_run_whose_events_cannot_be_written_goes_on_and_says_so_once(
    tiny: Tiny,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    breaks: str,
) -> None:
    import torch.utils.tensorboard as tensorboard

    def make(*_: Any, **__: Any) -> Events:
        if breaks == "opening":
            raise PermissionError(13, "Permission denied")
        return Events(breaks)

    monkeypatch.setattr(tensorboard, "SummaryWriter", make)
    summary = trained(tiny, tmp_path, {"run.tensorboard": True, "train.max_ticks": 30})
    assert summary["ticks"] == 30
    assert strict_json(tmp_path / "progress.json")["state"] == "done"
    (said,) = caplog.messages
    assert said.startswith("no events for TensorBoard from here on: ")


def test_a_file_that_cannot_be_written_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("training.recording.csv_log.os.fsync", refuse)
    with pytest.raises(OSError, match=r"No space left on device.*config\.yaml"):
        write_atomically(tmp_path / "config.yaml", "text")
    assert list(tmp_path.iterdir()) == []


# --- Stopping -------------------------------------------------------------------------------------


def test_a_stop_file_ends_a_run_at_the_next_window(tiny: Tiny, tmp_path: Path) -> None:
    (tmp_path / "stop").touch()
    summary = trained(tiny, tmp_path, {"train.max_ticks": 1000})
    assert (summary["ticks"], summary["windows"], summary["stopped_early"]) == (10, 1, True)


def test_a_session_begins_with_one_network_for_all_robots_and_both_rows(
    tiny: Tiny, tmp_path: Path
) -> None:
    session = TrainingRun(tiny(), RunFolder(tmp_path))
    first = session.initial_weights()
    session.recorder.close()
    assert np.array_equal(first[0], first[1])
    assert np.array_equal(first, session.initial_weights())
    assert first.std() > 0
