"""Which uploads the server hears: lost, late and not asked for; nothing of it by default."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from resume_helpers import check_goes_on, summary

from conf import Config, ConfigError, LossesConfig, compose
from experiments.cli import main
from storage.checkpoint_files import load_checkpoint
from storage.checkpoint_layout import server_folder
from training.exchange.facts import WindowFacts
from training.exchange.federation import build_federation
from training.exchange.reception import Reception

K, P = 4, 5
FACTS = WindowFacts(np.array([-60.0, -90.0, -70.0, -100.0]), np.zeros((K, 4), np.int64))


def config(fraction=1.0, **losses):
    base = Config()
    federation = dataclasses.replace(
        base.federation, fraction=fraction, losses=LossesConfig(**losses)
    )
    env = dataclasses.replace(base.env, robots=K)
    return dataclasses.replace(base, env=env, federation=federation)


def weights(seed):
    return np.random.default_rng(seed).normal(size=(K, 2, P)).astype(np.float32)


def hear(reception, window):
    return reception.heard(window, weights(0), weights(window), FACTS)


def test_by_default_all_are_heard_as_they_are():
    found = hear(Reception(config()), 1)
    np.testing.assert_array_equal(found.robots, range(K))
    np.testing.assert_array_equal(found.rows, weights(1))


@given(st.floats(0, 1), st.floats(0, 1), st.floats(0.01, 1))
def test_every_upload_has_one_fate_and_only_what_came_is_counted(probability, late, fraction):
    reception = Reception(config(fraction, probability=probability, late=late))
    rows = sum(len(hear(reception, window).robots) for window in range(1, 6))
    counts = reception.counts()
    assert sum(counts.values()) == 5 * K
    assert rows <= counts["heard"] + counts["late"]


def test_robots_below_the_outage_are_not_heard():
    found = hear(Reception(config(outage_db=-80.0)), 1)
    np.testing.assert_array_equal(found.robots, [0, 2])
    np.testing.assert_array_equal(found.rows, weights(1)[[0, 2]])


def test_losses_come_about_as_often_as_they_are_said_to():
    reception = Reception(config(probability=0.3))
    for window in range(1, 401):
        hear(reception, window)
    assert reception.counts()["lost"] / (400 * K) == pytest.approx(0.3, abs=0.05)


@pytest.mark.parametrize(("fraction", "count"), [(0.5, 2), (0.01, 1), (0.75, 3)])
def test_so_many_are_asked_and_in_turn_everybody(fraction, count):
    reception = Reception(config(fraction))
    asked = [tuple(hear(reception, window).robots) for window in range(1, 40)]
    assert {len(robots) for robots in asked} == {count}
    assert {robot for robots in asked for robot in robots} == set(range(K))


def test_a_late_step_is_added_to_what_the_robot_holds_a_window_later():
    reception = Reception(config(late=1.0))
    assert len(hear(reception, 1).robots) == 0
    held = weights(9)
    found = reception.heard(2, held, weights(2), FACTS)
    np.testing.assert_array_equal(found.robots, range(K))
    np.testing.assert_array_equal(found.rows, held + (weights(1) - weights(0)))


def test_a_late_step_is_added_to_an_upload_that_comes_with_it():
    late = Reception(config(late=1.0))
    hear(late, 1)
    other = Reception(config())
    other.restore(late.state())
    found = other.heard(2, weights(9), weights(2), FACTS)
    np.testing.assert_array_equal(found.rows, weights(2) + (weights(1) - weights(0)))


def test_where_nobody_is_heard_the_model_stays():
    federation = build_federation(config(probability=1.0))
    model = np.ones((2, 17), np.float32)
    uploads = np.zeros((K, 2, 17), np.float32)
    np.testing.assert_array_equal(federation.exchange(1, model, uploads, FACTS)[0], model)


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["federation.losses.late=2"], "federation.losses.late=2"),
        (["federation.fraction=0"], "federation.fraction=0"),
        (["federation.fraction=0.5", "strategy=krum"], "1.0 with strategy=krum"),
        (["federation.losses.probability=0.5", "strategy=none"], "0.0 with strategy=none"),
        (["attack=flip", "attack.robots=3"], "from 1 to 2"),
        (["attack=flip", "strategy=none"], "none with strategy=none"),
        (["attack=stale", "attack.scale=2"], "only noise, flip and scale read it"),
        (["attack.robots=1"], "nobody is hostile"),
    ],
)
def test_wrong_values_and_combinations_are_said_in_a_sentence(overrides, said):
    with pytest.raises(ConfigError, match=said.replace(".", r"\.")):
        compose(overrides)


def test_a_run_with_late_uploads_and_a_stale_robot_goes_on_to_the_same_bits(
    tiny_overrides, tmp_path
):
    changes = (
        *("train.max_ticks=50", "federation.every=5", "state.every=3", "evaluation.episodes=2"),
        *("federation.losses.late=0.6", "federation.losses.probability=0.2"),
        *("federation.fraction=0.67", "attack=stale"),
    )
    whole = tmp_path / "whole"
    assert main(["train", *tiny_overrides, *changes, f"run.dir={whole}"]) == 0
    arrays, _ = load_checkpoint(server_folder(whole / "state"), 6)
    assert "federation/reception/steps" in arrays  # some come after the run has died
    check_goes_on(whole, 6, "uploads")
    assert summary(whole)["uploads"]["late"] > 0
