"""Random streams: stable, independent of each other, and of the global generators."""

import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from env.seeding import Stream, derived_seed, stream

GOLDEN = {
    Stream.DESTINATIONS: 0.5651317655614634,
    Stream.WEIGHTS: 0.9453165290142962,
    Stream.WORLD: 0.2653024390130161,
    Stream.AP: 0.26594389956428566,
    Stream.ROBOT: 0.9411333018007978,
    Stream.EVALUATION: 0.7801057536547077,
    Stream.RADIO_MAP: 0.2007793516394134,
    Stream.GATHERING: 0.3249280568689673,
    Stream.FLOOR: 0.3145263762534257,
    Stream.ROOM: 0.05266094180087366,
    Stream.HELD_OUT_ROOM: 0.4523926109233761,
    Stream.PARTICIPATION: 0.16101842526937848,
    Stream.PRIVACY: 0.12873506727055173,
    Stream.LOCAL_NOISE: 0.23326128372418986,
    Stream.LOSSES: 0.20912490626974656,
    Stream.HEARD: 0.14613455379703533,
    Stream.ATTACK: 0.019813972472157104,
    Stream.GOSSIP: 0.40440910655587714,
}


@pytest.mark.parametrize("name", [*Stream])
def test_a_stream_begins_with_the_same_draw_in_every_version(name):
    assert stream(0, name).random() == GOLDEN[name]


def test_a_robots_stream_begins_with_the_same_draw_in_every_version():
    assert stream(7, Stream.ROBOT, 3).random() == 0.46071851949991993


def test_a_derived_seed_is_the_same_in_every_version_and_another_for_each_index():
    assert derived_seed(7, Stream.ROOM, 3) == 2786884391
    assert len({derived_seed(7, Stream.ROOM, index) for index in range(100)}) == 100


def test_names_seeds_and_indices_give_streams_of_their_own():
    first = {
        stream(seed, name, index).random()
        for seed in range(5)
        for name in Stream
        for index in range(5)
    }
    assert len(first) == 5 * len(Stream) * 5


@given(st.integers(0, 2**40), st.sampled_from([*Stream]), st.integers(0, 63))
def test_a_stream_depends_on_its_own_name_alone(seed, name, index):
    alone = stream(seed, name, index).random(4)
    others = [stream(seed, other, 0) for other in Stream]
    for other in others:
        other.random(100)
    assert (stream(seed, name, index).random(4) == alone).all()


def test_two_streams_of_a_seed_are_not_correlated():
    draws = [stream(0, name, k).standard_normal(20_000) for name in Stream for k in range(2)]
    correlation = np.corrcoef(draws)
    assert np.abs(correlation - np.eye(len(draws))).max() < 0.04


def test_the_global_generators_play_no_part():
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    first = stream(3, Stream.WORLD).random()
    random.seed(2)
    np.random.seed(2)  # noqa: NPY002
    assert stream(3, Stream.WORLD).random() == first
