"""Differential privacy: what is clipped and noised, from which stream, and what is accounted."""

from __future__ import annotations

import math

import numpy as np
import pytest
from flwr.supercore.differential_privacy import compute_clip_model_update
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from resume_helpers import check_goes_on

from conf import Config, PrivacyConfig, StrategyConfig, compose, problems
from env.seeding import Stream, stream
from experiments.cli import main
from experiments.runtimes import local
from training.aggregation.privacy import drawing_from
from training.aggregation.strategies import build_aggregator
from training.exchange.accounting import delta_of, epsilon_of, spent
from training.exchange.outbox import Outbox
from training.exchange.privacy import clipped
from training.run_folder import RunFolder

P, K = 40, 3
KINDS = ("central", "adaptive")


def aggregator(kind, seed=0, *, targets=True, **keys):
    dp = PrivacyConfig(name=kind, **keys)
    return build_aggregator(StrategyConfig(dp=dp), K, partial=True, seed=seed, targets=targets)


def weights(seed=0):
    """A model and three uploads, of which the second has not moved."""
    generator = np.random.default_rng(seed)
    current = generator.normal(size=(2, P)).astype(np.float32)
    steps = generator.normal(size=(K, 2, P)).astype(np.float32)
    steps[1] = 0
    return current, current + steps


@given(hnp.arrays(np.float64, (2, 5), elements=st.floats(-1e6, 1e6)), st.floats(1e-3, 1e3))
def test_a_clipped_step_has_at_most_the_norm_and_the_same_direction(step, clip):
    found = clipped(step, clip)
    norm = np.linalg.norm(step)
    assert np.linalg.norm(found) <= clip * (1 + 1e-12)
    np.testing.assert_allclose(found * max(1.0, norm / clip), step, rtol=1e-9, atol=1e-300)


def test_clipping_is_flowers():
    current, uploads = (each.astype(np.float64) for each in weights())
    theirs = [uploads[0].copy()]
    compute_clip_model_update(theirs, [current], 2.0)
    np.testing.assert_allclose(current + clipped(uploads[0] - current, 2.0), theirs[0], rtol=1e-14)


@pytest.mark.parametrize("kind", KINDS)
def test_without_noise_the_mean_of_clipped_steps_is_taken(kind):
    current, uploads = weights()
    found = aggregator(kind, clip=2.0).aggregate(1, current, uploads)
    steps = uploads.astype(np.float64) - current
    expected = current + np.mean([clipped(step, 2.0) for step in steps], axis=0)
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_noise_depends_on_seed_and_window_alone(kind):
    current, uploads = weights()

    def found(seed, window):
        return aggregator(kind, seed, noise=0.1).aggregate(window, current, uploads)

    assert found(0, 1).tobytes() == found(0, 1).tobytes()
    assert not np.array_equal(found(0, 1), found(1, 1))
    assert not np.array_equal(found(0, 1), found(0, 2))


@pytest.mark.parametrize("heard", [K, 2])
def test_central_noise_is_z_clip_over_those_that_were_heard(heard):
    current, uploads = np.zeros((2, 20_000), np.float32), np.zeros((heard, 2, 20_000), np.float32)
    found = aggregator("central", clip=2.0, noise=0.3).aggregate(1, current, uploads)
    assert found.std() == pytest.approx(0.3 * 2.0 / heard, rel=0.02)


@pytest.mark.parametrize("kind", KINDS)
def test_numpys_global_generator_is_left_as_it_was(kind):
    current, uploads = weights()
    np.random.seed(5)  # noqa: NPY002 - the one that is to be left alone
    np.random.normal()  # noqa: NPY002 - leaves the second of a pair for later
    before = np.random.get_state(legacy=False)  # noqa: NPY002
    aggregator(kind, noise=0.1).aggregate(1, current, uploads)
    after = np.random.get_state(legacy=False)  # noqa: NPY002
    assert before["has_gauss"] == after["has_gauss"] == 1
    assert before["gauss"] == after["gauss"]
    assert np.array_equal(before["state"]["key"], after["state"]["key"])


def test_numpys_global_functions_draw_from_a_stream_for_a_while():
    with drawing_from(stream(3, Stream.PRIVACY, 1)):
        first = np.random.standard_normal()  # noqa: NPY002
    with drawing_from(stream(3, Stream.PRIVACY, 1)):
        assert np.random.standard_normal() == first  # noqa: NPY002
    assert np.random.standard_normal() != first  # noqa: NPY002


def test_an_adaptive_clip_goes_to_the_quantile():
    """Steps of the norms 1, 2 and 3: half of them stay whole where the clip is about 2."""
    steps = np.zeros((K, 2, P), np.float32)
    steps[:, 0, 0] = (1, 2, 3)
    for start in (0.1, 30.0):
        adaptive = aggregator("adaptive", clip=start)
        for window in range(1, 60):
            adaptive.aggregate(window, np.zeros((2, P), np.float32), steps)
        assert 1.7 < adaptive._strategy.clipping_norm < 2.4


def test_an_adaptive_clip_comes_back_with_the_state():
    current, uploads = weights()
    whole, first, second = (aggregator("adaptive", noise=0.1) for _ in range(3))
    for window in (1, 2):
        whole.aggregate(window, current, uploads)
        first.aggregate(window, current, uploads)
    second.restore(first.state())
    results = [each.aggregate(3, current, uploads) for each in (whole, second)]
    assert results[0].tobytes() == results[1].tobytes()


def test_online_networks_alone_are_clipped_where_targets_are_copied():
    current, uploads = weights()
    uploads[:, 1] = uploads[:, 0]
    found = aggregator("central", clip=2.0, targets=False).aggregate(1, current, uploads)
    steps = uploads[:, 0].astype(np.float64) - current[0]
    expected = current[0] + np.mean([clipped(step, 2.0) for step in steps], axis=0)
    np.testing.assert_allclose(found[0], expected, atol=1e-6)


def sent(config, robot, window):
    current, uploads = weights()
    box = Outbox(config, robot, P)
    box.take(current)
    return box.send(window, uploads[0]), current, uploads[0]


def local_config(*overrides):
    return compose(["runtime=local", "strategy/dp=local", "strategy.dp.clip=2", *overrides])


def test_a_robot_sends_its_clipped_step():
    found, current, own = sent(local_config("strategy.dp.noise=0"), 0, 1)
    np.testing.assert_allclose(found - current, clipped(own - current, 2.0), atol=1e-6)


def test_local_noise_depends_on_seed_robot_and_window_alone():
    config = local_config("strategy.dp.noise=0.5")
    first = sent(config, 0, 1)[0].tobytes()
    assert sent(config, 0, 1)[0].tobytes() == first
    others = [sent(config, 1, 1), sent(config, 0, 2), sent(local_config("seed=1"), 0, 1)]
    assert len({first, *(each[0].tobytes() for each in others)}) == 4


def test_a_robot_noises_what_it_sends_where_targets_are_copied():
    config = local_config("federation.compression.targets=copied", "strategy.dp.noise=0.1")
    packed, _, _ = sent(config, 0, 1)
    step = np.ascontiguousarray(packed).view("<f4")
    assert step.shape == (P,)
    assert np.linalg.norm(step) < 2.0 + 0.2 * 2 * math.sqrt(P)


# --- Accounting -----------------------------------------------------------------------------------


def test_epsilon_is_that_of_the_analytic_gaussian_mechanism():
    """3.7306 deviations for (1, 1e-5), as the program of Balle and Wang gives it."""
    assert epsilon_of(1 / 3.730632, 1e-5) == pytest.approx(1.0, abs=1e-6)


def test_epsilon_is_that_of_privacy_loss_distributions_and_below_renyis_bound():
    """As ``dp-accounting`` gives them: for mu = 1 its two accountants, for mu = 200 the bound."""
    assert epsilon_of(1.0, 1e-5) == pytest.approx(4.3771781, abs=1e-6)
    assert epsilon_of(1.0, 1e-5) < 4.728507
    assert 0.9 * 22111.778 < epsilon_of(200.0, 1e-5) < 22111.778


@given(st.floats(1e-2, 1e5), st.floats(1e-12, 0.4))
def test_epsilon_keeps_its_delta_and_what_looser_bounds_promise(mu, delta):
    epsilon = epsilon_of(mu, delta)
    assert delta_of(mu, epsilon) <= delta * (1 + 1e-6)
    assert epsilon < 1e-9 or delta_of(mu, epsilon * (1 - 1e-6)) >= delta * (1 - 1e-4)
    assert 0 <= epsilon <= mu * mu / 2 + mu * math.sqrt(2 * math.log(1 / delta))


@given(st.floats(1e-2, 1e3), st.floats(1e-10, 0.1))
def test_more_noise_costs_less(mu, delta):
    assert epsilon_of(mu, delta) >= epsilon_of(mu * 0.9, delta) - 1e-12


def spent_of(windows=100, **keys):
    return spent(Config(strategy=StrategyConfig(dp=PrivacyConfig(**keys))), windows)


def test_a_run_spends_over_all_its_windows():
    found = spent_of(name="central", noise=20.0)
    assert found["epsilon"] == epsilon_of(0.5, 1e-5)
    assert (found["releases"], found["delta"]) == (100, 1e-5)


def test_local_privacy_is_against_any_other_upload():
    """Which may lie two clips away."""
    assert (
        spent_of(name="local", noise=2.0)["epsilon"]
        == spent_of(name="central", noise=1.0)["epsilon"]
    )


def test_without_noise_nothing_is_promised():
    assert spent_of(name="none") is None
    assert spent_of(name="central")["epsilon"] is None
    assert spent_of(name="central", noise=1e-300)["epsilon"] is None


# --- Whole runs -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [*KINDS, "local"])
def test_a_run_repeats_and_says_what_it_has_spent(kind, tiny, tmp_path):
    config = tiny({"strategy.dp": PrivacyConfig(name=kind, noise=0.1), "train.max_ticks": 20})
    summary = local.train(config, RunFolder(tmp_path / "a"))
    again = local.train(config, RunFolder(tmp_path / "b"))
    assert summary["digest"] == again["digest"]
    assert summary["privacy"]["mechanism"] == kind
    assert summary["privacy"]["epsilon"] == spent(config, 2)["epsilon"]


@pytest.mark.parametrize("kind", ["adaptive", "local"])
def test_a_private_run_that_goes_on_ends_in_the_same_bits(kind, tiny_overrides, tmp_path):
    private = (f"strategy/dp={kind}", "strategy.dp.noise=0.1", "state.every=2")
    whole = tmp_path / "whole"
    given = ["train", *tiny_overrides, *private, "train.max_ticks=60", f"run.dir={whole}"]
    assert main(given) == 0
    check_goes_on(whole, 4, "privacy")


@pytest.mark.parametrize(
    ("overrides", "key"),
    [
        ({"name": "krum", "dp": PrivacyConfig(name="central")}, "strategy.dp.name"),
        ({"name": "none", "dp": PrivacyConfig(name="local")}, "strategy.dp.name"),
        ({"dp": PrivacyConfig(name="central", quantile=0.2)}, "strategy.dp.quantile"),
        ({"dp": PrivacyConfig(noise=0.2)}, "strategy.dp.noise"),
    ],
)
def test_what_gives_no_privacy_is_refused(overrides, key):
    assert [each[0] for each in problems(Config(strategy=StrategyConfig(**overrides)))] == [key]
