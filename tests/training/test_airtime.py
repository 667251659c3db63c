"""What the exchange of weights takes of the channel, and whom the server hears."""

import json
from functools import cache

import numpy as np
import pytest

from conf import compose, robot_network
from training.communication import per_tick
from training.exchange.airtime import Airtime, left_over
from training.exchange.facts import WindowFacts
from training.exchange.federation import build_federation
from training.exchange.reception import Reception

COPY = 2 * 4 * 6104
"""Bytes of two of the default networks."""
MEASURES = {"ee": 2.0, "ee_bits_per_joule": 3.0}
ALL = np.arange(3)


def facts(*channel_db):
    """A window of 25 slots in which each of three robots drove in 20."""
    return WindowFacts(np.array(channel_db), np.full((3, 4), 5))


def rate(channel_db):
    """At 20 dBm over -100 dBm."""
    return np.log2(1.0 + 10 ** ((channel_db + 120) / 10))


@cache
def composed(*overrides):
    return compose(list(overrides))


def account(windows, *overrides, asked=ALL):
    found = Airtime(composed(*overrides))
    for window in windows:
        found.add(window, asked)
    return found.summary(MEASURES)


def test_uploads_come_one_after_the_other_and_the_weakest_sets_the_broadcast():
    found = account([facts(-60.0, -80.0, -100.0)])
    expected = 8e-6 * COPY * sum(1 / rate(db) for db in (-60, -80, -100, -100))
    assert found["slots"] == pytest.approx(expected)
    assert found["share"] == pytest.approx(expected / 25)
    assert found["joules"] == pytest.approx(0.1 * expected)
    assert found["driving_joules"] == pytest.approx(60 * (7.4 * 0.5 + 0.29))


def test_only_those_that_are_asked_send_and_all_are_sent_to():
    found = account([facts(-60.0, -80.0, -100.0)], asked=np.array([0]))
    assert found["slots"] == pytest.approx(8e-6 * COPY * (1 / rate(-60) + 1 / rate(-100)))


def test_a_band_ten_times_as_wide_takes_a_tenth_and_slots_are_as_long_as_a_cell_takes():
    wide = account([facts(-60.0, -80.0, -100.0)], "federation.airtime.bandwidth_hz=1e7")
    one = account([facts(-60.0, -80.0, -100.0)])
    assert one["slots"] == pytest.approx(10 * wide["slots"])
    slow = account([facts(-60.0, -80.0, -100.0)], "env.motion.speed_mps=0.25")
    assert one["slots"] == pytest.approx(2 * slow["slots"])
    assert one["joules"] == pytest.approx(slow["joules"])


def test_packed_weights_take_as_much_less_as_they_are_smaller():
    keys = [f"federation.compression.{key}" for key in ("up=q1", "down=q1", "targets=copied")]
    found, plain = (account([facts(-70.0, -70.0, -70.0)], *each) for each in (keys, []))
    assert found["slots"] / plain["slots"] == pytest.approx((24 + 6104 / 8) / COPY)


def test_a_fade_to_nothing_takes_long_and_not_for_ever():
    found = account([facts(-np.inf, -80.0, -80.0)])
    assert found["slots"] == pytest.approx(8e-6 * COPY * (2 / 0.01 + 2 / rate(-80)))


def test_worlds_side_by_side_count_as_one():
    window = facts(-60.0, -80.0, -100.0)
    four = WindowFacts(window.channel_db, 4 * window.actions)
    assert account([four], "train.worlds=4") == account([window])


def test_the_account_goes_on_from_its_state():
    windows = [facts(-60.0, -80.0, -100.0), facts(-90.0, -85.0, -70.0)]
    first, second = Airtime(composed()), Airtime(composed())
    first.add(windows[0], ALL)
    second.restore(first.state())
    second.add(windows[1], ALL)
    assert second.summary(MEASURES) == account(windows)
    second.restore({})
    assert second.summary(MEASURES)["slots"] == 0


def test_what_is_counted_is_less_and_nothing_where_weights_take_all():
    found = account([facts(-60.0, -80.0, -100.0)])
    left = (1 - found["share"]) / (1 + found["joules"] / found["driving_joules"])
    assert 0.9 < left < 1
    assert found["ee_counted"] == pytest.approx(left * 2.0)
    assert found["ee_bits_per_joule_counted"] == pytest.approx(left * 3.0)
    assert left_over(1.3, 1.0, 1.0) == 0
    nothing = account([])
    assert [nothing[f"{name}_counted"] for name in MEASURES] == [2.0, 3.0]


# --- Whom the server hears ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("hear", "asked"), [(None, [0, 1, 2, 3]), (1, [1]), (2, [1, 3]), (3, [1, 2, 3])]
)
def test_the_best_channels_are_asked_and_ties_go_to_the_first_robot(tiny, hear, asked):
    rows = np.zeros((4, 2, 1), np.float32)
    window = facts(-80.0, -60.0, -70.0, -60.0)
    found = Reception(tiny({"federation.hear": hear})).heard(1, rows, rows, window)
    assert found.asked.tolist() == asked


@pytest.mark.parametrize(("hear", "mean"), [(1, 2.0), (2, 1.5), (3, 4 / 3)])
def test_the_mean_is_of_those_that_are_heard(tiny, hear, mean):
    config = tiny({"federation.hear": hear})
    shape = (2, robot_network(config).parameters)
    uploads = np.stack([np.full(shape, value, np.float32) for value in (1, 2, 1)])
    window = facts(-90.0, -50.0, -70.0)
    found = build_federation(config).exchange(1, np.zeros(shape, np.float32), uploads, window)
    np.testing.assert_allclose(found[0], mean, rtol=1e-6)


# --- What runs say of it --------------------------------------------------------------------------


def test_bytes_that_are_packed_or_not_heard_are_not_counted():
    packed = ["federation.compression.up=q8", "federation.compression.targets=copied"]
    found = per_tick(compose(["federation.hear=2", *packed]))
    assert found["weights_per_window"] == 2 * (24 + 6104) + 3 * 4 * 6104


def test_a_run_says_what_its_exchanges_took(tiny_run):
    summary = json.loads((tiny_run / "summary.json").read_text())
    found = summary["airtime"]
    assert 0 < found["share"] < 1
    assert found["ee"] == summary["evaluation"]["last5"]["ee"]
    assert found["ee_counted"] < found["ee"]
