"""What the world looks up is, bit for bit, what it would compute."""

from typing import Any

import numpy as np
import pytest

from env import scenario as scenarios
from env.checks import checked_config
from env.radio import radio_map
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World

SMALL: dict[str, Any] = {
    "room": {"width_m": 10.0, "depth_m": 8.0},
    "walls": {"segments": [[0.0, 4.0, 7.0, 4.0]]},
}
SMALL |= {"ap": {"position_m": [5.0, 8.0, 2.0]}, "ris": {"position_m": [10.0, 2.0, 2.0]}}
SMALL |= {
    "tasks": {
        "destinations_m": [[8.2, 2.2], [1.2, 1.2]],
        "start_distance_m": 3.0,
        "destination_spacing_m": 1.0,
    }
}

VARIANTS: list[dict[str, Any]] = [
    {},
    {"ris": {"side": 0}},
    {"ris": {"side": 12, "subsurfaces": 6}},
    {"ris": {"side": 12, "subsurfaces": 3, "bits": 3, "response": "near"}},
    {"ris": {"side": 9, "subsurfaces": 9, "bits": 1, "response": "rayleigh"}},
    {"robots": 5},
    {"state": {"destination": "none"}},
    {"channel": {"los_phase": "distance"}},
    {"metric": "qoe", "access": "oma"},
    {"ris": {"side": 6, "response": "near", "action": "codebook", "sectors": [3, 2]}},
    {"channel": {"fading": "slot"}},
    {"robots": 4, "reward": {"credit": "difference", "weights": "objective"}},
    {"state": {"way": "on", "destination": "none"}, "channel": {"fading": "slot"}},
    {"robots": 4, "state": {"weights": True, "order": "gain"}},
    {"robots": 3, "state": {"others": 2, "way": "on"}},
    {"robots": 3, "state": {"others": 1}, "channel": {"fading": "slot"}},
    {"collisions": "block", "walls": {"segments": [[0.0, 4.0, 7.0, 4.0]], "block_motion": True}},
]


def configured(changes):
    merged = {**SMALL, **changes}
    merged["ris"] = {**SMALL["ris"], **changes.get("ris", {})}
    return checked_config(merged)


def played(config, slots=12):
    """What is seen and gained in a few slots of seven worlds."""
    worlds = World(Scenario.drawn(config, 3), stream(3, Stream.WORLD), 7)
    worlds.reset()
    moves = np.random.default_rng(1)
    found: list[Any] = []
    for _ in range(slots):
        phase = moves.integers(worlds.phase_actions, size=7)
        direction = moves.integers(4, size=worlds.cell.shape)
        level = moves.integers(1, config.power.levels + 1, size=worlds.cell.shape)
        outcome = worlds.step(phase, direction, level)
        found += [outcome.rate, outcome.local_reward, outcome.global_reward]
        found += [worlds.local_observations(), worlds.global_observation()]
    return found


@pytest.mark.parametrize("changes", VARIANTS, ids=str)
def test_an_episode_is_the_same_without_tables(changes, monkeypatch):
    config = configured(changes)
    looked_up = played(config)
    monkeypatch.setattr(radio_map, "MAX_TABLE", 0)
    monkeypatch.setattr(scenarios, "MAX_SEEN", 0)
    for found, computed in zip(looked_up, played(config), strict=True):
        assert found.dtype == computed.dtype
        np.testing.assert_array_equal(found, computed)


def test_all_gains_of_a_map_with_4096_settings_are_those_of_the_channel():
    room = {**SMALL["room"], "cell_m": 2.0}
    config = configured({"ris": {"side": 12, "subsurfaces": 6}, "room": room})
    tables = radio_map.build_radio_map(config)
    cell = np.arange(len(tables.direct))
    assert tables._gains is not None
    for action in (0, 1, 77, 4095):
        channel = tables.channel(cell, np.array(action))
        expected = channel.real**2 + channel.imag**2
        np.testing.assert_array_equal(tables.gain(cell, np.array(action)), expected)
