"""Weights in fewer bytes: what packing loses, what becomes of it, and hostile bytes."""

import numpy as np
import pytest
from exchange_helpers import in_process, over_sockets
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from resume_helpers import check_goes_on

from client_app.rooms import HostedRoom
from conf import ConfigError, compose, robot_network
from conf.rooms import rooms_of
from experiments.cli import main
from storage.checkpoint_files import digest
from training.exchange.facts import WindowFacts
from training.exchange.federation import build_federation
from training.exchange.packers import build_packer
from training.exchange.packing import PackedSender, Packing, packing, payload_bytes

BLOCKS = (5, 1, 9, 3)
NUMBERS = sum(BLOCKS)
STARTS = np.cumsum(BLOCKS) - BLOCKS
KINDS = ("none", "q8", "q4", "q1", "topk")
COMPRESSION = "federation.compression"
VALUES = arrays(np.float32, NUMBERS, elements=st.floats(-1e6, 1e6, width=32))


def packer(kind):
    return build_packer(kind, 0.2, BLOCKS)


# --- One vector -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "most"), [("q8", 127), ("q4", 7)])
@given(values=VALUES)
def test_a_quantised_number_is_off_by_half_a_step_of_its_block(kind, most, values):
    found = packer(kind).unpack(packer(kind).pack(values))
    largest = np.repeat(np.maximum.reduceat(np.abs(values), STARTS), BLOCKS).astype(float)
    assert (np.abs(found - values.astype(float)) <= largest / (2 * most) * (1 + 1e-5) + 1e-37).all()


@given(values=VALUES)
def test_a_sign_comes_with_the_mean_magnitude_of_its_block(values):
    found = packer("q1").unpack(packer("q1").pack(values))
    mean = np.add.reduceat(np.abs(values).astype(float), STARTS) / BLOCKS
    np.testing.assert_allclose(np.abs(found), np.repeat(mean, BLOCKS), rtol=1e-6, atol=1e-44)
    assert (np.sign(found) * np.sign(values) >= 0).all()


@given(values=VALUES)
def test_the_largest_numbers_arrive_as_they_are_and_all_others_as_nothing(values):
    found = packer("topk").unpack(packer("topk").pack(values))
    kept = found != 0
    np.testing.assert_array_equal(found[kept], values[kept])
    largest = np.sort(np.abs(values))[::-1][: round(0.2 * NUMBERS)]
    np.testing.assert_array_equal(np.sort(np.abs(found[kept]))[::-1], largest[largest > 0])


def test_of_equal_numbers_the_first_are_sent():
    found = packer("topk").unpack(packer("topk").pack(np.full(NUMBERS, -2.0, np.float32)))
    assert found.tolist() == [-2.0] * 4 + [0.0] * (NUMBERS - 4)


@pytest.mark.parametrize(
    ("kind", "size"), [*zip(KINDS, (4 * 18, 16 + 18, 16 + 9, 16 + 3, 4 * 6), strict=True)]
)
@given(values=VALUES)
def test_what_is_packed_has_the_same_size_whatever_it_is(kind, size, values):
    packed = packer(kind).pack(values)
    assert packed.dtype == np.uint8
    assert packed.shape == (packer(kind).size,) == (size,)


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
def test_any_bytes_are_numbers_or_refused(kind, data):
    packed = np.frombuffer(
        data.draw(st.binary(min_size=(n := packer(kind).size), max_size=n)), "u1"
    )
    try:
        found = packer(kind).unpack(packed)
    except ValueError:
        assert kind != "none"
        return
    assert found.shape == (NUMBERS,)
    assert found.dtype == np.float32


@pytest.mark.parametrize("kind", KINDS)
def test_a_network_that_is_no_number_is_not_hidden(kind):
    values = np.ones(NUMBERS, np.float32)
    values[7] = np.nan
    packed = packer(kind).pack(values)
    if kind in ("none", "topk"):
        assert np.isnan(packer(kind).unpack(packed)[7])
    else:
        with pytest.raises(ValueError, match="a scale is nan"):
            packer(kind).unpack(packed)


# --- Many windows ---------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("targets", [True, False])
def test_what_is_lost_arrives_later(kind, targets):
    parameters = NUMBERS // 2 if targets else NUMBERS
    how = Packing(packer(kind), parameters, targets=targets)
    sender, generator = PackedSender(how), np.random.default_rng(0)
    held = wanted = np.zeros((2, parameters), np.float32)
    for _ in range(200):
        step = generator.normal(size=held.shape).astype(np.float32)
        wanted = wanted + step
        held = how.added(held, sender.send(held, held + step))
    rows = slice(None) if targets else slice(1)
    lost = sender.state()["lost"].reshape(-1, parameters)
    np.testing.assert_allclose((held[rows] + lost), wanted[rows], atol=1e-3)
    assert targets or (held[0] == held[1]).all()
    assert np.abs(lost).max() < (1e-4 if kind == "none" else 30)


def test_blocks_are_the_weights_and_the_biases_of_the_layers():
    config = compose([f"{COMPRESSION}.up=q1", f"{COMPRESSION}.down=q8"])
    parameters = robot_network(config).parameters
    assert payload_bytes(config) == (2 * (6 * 4 + parameters // 8), 2 * (6 * 4 + parameters))
    assert packing(compose([]), parameters) == (None, None)
    copied = compose([f"{COMPRESSION}.targets=copied", f"{COMPRESSION}.up=topk"])
    assert payload_bytes(copied) == (6 * round(0.01 * parameters), 4 * parameters)


# --- Runs -----------------------------------------------------------------------------------------

Q1 = {"up": "q1", "down": "q1", "targets": "copied"}
PACKED = (
    {"up": "q8"},
    {"down": "q4"},
    {"up": "topk", "down": "topk", "keep": 0.05},
    {"targets": "copied"},
    Q1,
)


def packed_run(tiny, changes, ticks=50):
    named = {f"{COMPRESSION}.{key}": value for key, value in changes.items()}
    return tiny({"train.max_ticks": ticks, **named})


def test_sockets_and_groups_change_no_bit_of_a_packed_run(tiny):
    ends = {digest(in_process(packed_run(tiny, {})))}
    for changes in PACKED:
        config = packed_run(tiny, changes)
        blocks = [(0,), (2, 1)]
        end = digest(in_process(config))
        assert digest(in_process(config, blocks)) == end
        assert digest(over_sockets(config, blocks)) == end
        ends.add(end)
    assert len(ends) == 1 + len(PACKED)


def test_copied_targets_are_the_averaged_online_networks(tiny):
    end = in_process(packed_run(tiny, Q1, 100))
    np.testing.assert_array_equal(end[:, 0], end[:, 1])
    plain = in_process(packed_run(tiny, {}, 100))
    assert (plain[:, 0] != plain[:, 1]).any()


@pytest.mark.parametrize(
    "changes",
    [
        ("up=q1", "down=q4", "targets=copied"),
        pytest.param(("up=topk", "down=topk", "keep=0.05"), marks=pytest.mark.slow),
    ],
)
def test_a_packed_run_goes_on_to_the_same_bits(tiny_overrides, tmp_path, changes):
    options = [f"{COMPRESSION}.{each}" for each in changes]
    options += ["federation.hear=2", "state.every=3", "evaluation.every=2"]
    whole = tmp_path / "whole"
    given = [*tiny_overrides, *options, "train.max_ticks=120", f"run.dir={whole}"]
    assert main(["train", *given]) == 0
    check_goes_on(whole, 6, "airtime")


# --- The server -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "forged", "says"),
    [
        ("q8", np.array([np.nan], "<f4"), "a scale is nan"),
        ("q4", np.array([-1.0], "<f4"), "a scale is -1"),
        ("q1", np.array([np.inf], "<f4"), "a scale is inf"),
        ("topk", np.array([65535], "<u2"), "places"),
    ],
)
def test_hostile_bytes_name_the_robot_that_sent_them(tiny, kind, forged, says):
    config = packed_run(tiny, {"up": kind})
    size, parameters = payload_bytes(config)[0], robot_network(config).parameters
    uploads = np.zeros((3, size), np.uint8)
    if kind == "topk":  # honest places for all, before one of them is forged
        kept = size // 6
        uploads[:, : 2 * kept] = np.arange(kept, dtype="<u2").view(np.uint8)
    uploads[1, : forged.nbytes] = forged.view(np.uint8)
    facts = WindowFacts(np.full(3, -60.0), np.ones((3, 24), np.int64))
    with pytest.raises(ValueError, match=f"packed weights of robot 1: .*{says}"):
        build_federation(config).exchange(1, np.zeros((2, parameters), "f4"), uploads, facts)


def test_a_scale_beyond_all_measure_is_refused_as_absurd_weights(tiny):
    config = packed_run(tiny, {"up": "q8"})
    size, parameters = payload_bytes(config)[0], robot_network(config).parameters
    uploads = np.zeros((3, size), np.uint8)
    uploads[2] = 0x7F
    uploads[2, :48] = np.full(12, 3e38, "<f4").view(np.uint8)
    facts = WindowFacts(np.full(3, -60.0), np.ones((3, 24), np.int64))
    with pytest.raises(ValueError, match="absurd weights from robot 2"):
        build_federation(config).exchange(1, np.zeros((2, parameters), "f4"), uploads, facts)


# --- What is allowed ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ([f"{COMPRESSION}.up=q2"], "one of none, q8, q4, q1, topk"),
        ([f"{COMPRESSION}.keep=0.2"], "only topk reads it"),
        ([f"{COMPRESSION}.up=topk", f"{COMPRESSION}.keep=0"], "above 0"),
        (["strategy=none", f"{COMPRESSION}.up=q1"], "no weights are exchanged"),
        (["strategy=none", "federation.hear=1"], "nothing is uploaded"),
        (["baseline=centralized", f"{COMPRESSION}.targets=copied"], "no weights are exchanged"),
        (["federation.hear=4"], "from 1 to the robots there are, 3"),
        (["federation.hear=0"], "1"),
        (["rooms.count=4", "rooms.robots=[2,3]", "federation.hear=3"], "there are, 2"),
        (["strategy=krum", "federation.hear=3"], "needs the uploads of all"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(given, says):
    with pytest.raises(ConfigError, match=says):
        compose(["runtime=local", *given])


def test_a_room_packs_and_goes_on_from_its_state(tiny_building):
    changes = {f"{COMPRESSION}.{key}": value for key, value in Q1.items()}
    building = tiny_building({**changes, "federation.hear": 1})
    config = rooms_of(building)[0].config(building)
    first = np.stack([np.zeros(robot_network(config).parameters, np.float32)] * 2)
    whole, resumed = HostedRoom(config), HostedRoom(config)
    model = whole.play(2, first).model
    resumed.restore(whole.state())
    ends = [room.play(2, model).model for room in (whole, resumed)]
    np.testing.assert_array_equal(*ends)
    np.testing.assert_array_equal(ends[0][0], ends[0][1])
    assert (ends[0] != model).any()
