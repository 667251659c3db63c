"""What is kept of episodes slot by slot, and what of it a run's folder gets."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from conf import Config, from_yaml
from env.episode import EpisodeMeasures
from experiments.analysis import played
from training.evaluation import Evaluator
from training.recording.history import evaluate
from training.run_folder import RunFolder
from training.trace import Trace, recorded

Tiny = Callable[..., Config]
Weights = tuple[NDArray[np.float32], NDArray[np.float32]]


@pytest.fixture
def driven(tiny_run: Path) -> played.PlayedEpisodes:
    config = from_yaml((tiny_run / "config.yaml").read_text())
    weights = RunFolder(tiny_run).read_weights(config)
    return played.learned(Evaluator(config), weights, 0.3)


@pytest.fixture
def weights(tiny_run: Path) -> Weights:
    folder = RunFolder(tiny_run)
    return folder.read_weights(folder.read_config())


def first(measures: EpisodeMeasures, name: str) -> float:
    return float(getattr(measures, name)[0])


def test_a_recorded_episode_adds_up_to_its_measures(driven: played.PlayedEpisodes) -> None:
    episode = recorded(driven.along, driven.world, driven.measures)
    slots = episode["slots"]
    assert len(episode["cells"]) == slots + 1
    assert {len(episode[name]) for name in ("driving", "rates", "powers_w", "order")} == {slots}
    mean = np.sum(episode["rates"]) / slots
    assert mean == pytest.approx(first(driven.measures, "sum_rate"), abs=1e-3)
    arrived = np.array(episode["cells"][-1]) == driven.world.destinations
    assert arrived.mean() == first(driven.measures, "success") == episode["success"]


def test_robots_that_drive_are_ordered_by_their_channels_weakest_first(
    driven: played.PlayedEpisodes,
) -> None:
    episode = recorded(driven.along, driven.world, driven.measures)
    for order, gains, driving in zip(
        episode["order"], episode["gains_db"], episode["driving"], strict=True
    ):
        assert sorted(order) == np.flatnonzero(driving).tolist()
        assert np.diff(np.array(gains)[order]).min(initial=0) >= 0


def test_powers_are_sent_to_those_who_drive_and_keep_the_budget(
    driven: played.PlayedEpisodes,
) -> None:
    episode = recorded(driven.along, driven.world, driven.measures)
    powers, driving = np.array(episode["powers_w"]), np.array(episode["driving"], dtype=bool)
    assert (powers[~driving] == 0).all()
    assert powers.sum(axis=-1).max() <= driven.world.downlink.max_power_w + 1e-6


def test_phases_are_degrees_of_sub_surfaces_or_beams_of_a_codebook(tiny: Tiny) -> None:
    def of(changes: dict[str, Any]) -> dict[str, Any]:
        ruled = played.ruled(Evaluator(tiny(changes), episodes=1))
        return recorded(ruled.along, ruled.world, ruled.measures)

    phases = of({"env.ris.subsurfaces": 2, "env.ris.bits": 2})["phases_deg"]
    assert {len(each) for each in phases} == {2}
    assert {value % 45 for each in phases for value in each} == {0}
    beams = of(
        {"env.ris.action": "codebook", "env.ris.response": "near", "env.ris.sectors": [2, 3]}
    )
    assert "phases_deg" not in beams
    assert set(beams["beams"]) <= set(range(6))


def test_a_trace_of_some_worlds_is_that_part_of_the_whole(tiny: Tiny, weights: Weights) -> None:
    evaluator, whole, part = Evaluator(tiny()), Trace(), Trace(slice(2, 3))
    for trace in (whole, part):
        evaluator.play(*weights, (0.2,), trace.see)
        trace.finish(evaluator.world)
    for name in ("cells", "driving", "gains", "rates", "powers_w", "orders", "phases"):
        of_all, of_one = (np.stack(getattr(trace, name)) for trace in (whole, part))
        np.testing.assert_array_equal(of_all[:, 2:3], of_one)


def test_an_evaluation_hands_out_its_first_greedy_episode(tiny: Tiny, weights: Weights) -> None:
    evaluator, trace = Evaluator(tiny()), Trace()
    (greedy,) = evaluator.play(*weights, (0.0,), trace.see)
    trace.finish(evaluator.world)
    assert evaluate(Evaluator(tiny()), *weights, 0.5).episode == recorded(
        trace, evaluator.world, greedy
    )


def test_a_run_leaves_the_episode_of_its_final_weights(tiny_run: Path) -> None:
    folder = RunFolder(tiny_run)
    config = folder.read_config()
    found = evaluate(Evaluator(config), *folder.read_weights(config), 0.05).episode
    written = folder.read_episode()
    assert written is not None
    progress = folder.read_progress()
    assert progress is not None
    assert (written.pop("tick"), written.pop("episode")) == (progress["tick"], progress["episode"])
    assert written == json.loads(json.dumps(found))


def test_each_room_of_a_building_leaves_one(building_run: Path) -> None:
    folder = RunFolder(building_run)
    for name in ("0000", "0001", "0002", "held-out-0000"):
        episode = folder.room(name).read_episode()
        assert episode is not None
        assert len(episode["cells"]) == episode["slots"] + 1


@pytest.mark.parametrize("text", ["", "{", "[1]", "3"])
def test_a_damaged_episode_counts_as_none(tmp_path: Path, text: str) -> None:
    folder = RunFolder(tmp_path)
    assert folder.read_episode() is None
    folder.episode_file.write_text(text)
    assert folder.read_episode() is None
