"""Channels from a file: what is written is read to equality, and what does not fit is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from env import plugins
from env.checks import checked_config
from env.config import EnvConfig
from env.plugins import PluginError
from env.radio.channel_file import problems, write_channels
from env.radio.radio_map import build_radio_map
from env.scenario import Scenario
from env.world import World

ROOM = {"room": {"width_m": 6.0, "depth_m": 4.0}, "ap": {"position_m": [3.0, 4.0, 2.0]}}
SMALL: dict[str, Any] = {
    **ROOM,
    "robots": 2,
    "walls": {"segments": [[0.0, 2.0, 4.0, 2.0]]},
    "ris": {"position_m": [6.0, 1.0, 2.0], "side": 4, "subsurfaces": 2, "response": "near"},
    "tasks": {"destinations_m": [[1.25, 1.25], [5.25, 3.25]], "start_distance_m": 1.0},
}


def from_file(path: Path, **changes: Any) -> EnvConfig:
    """The small room with channels from a file; of the model, N alone is kept."""
    ris = {**SMALL["ris"], "response": "coherent"}
    channel = {"model": "file", "file": str(path), **changes.pop("channel", {})}
    return checked_config({**SMALL, "ris": ris, "channel": channel, **changes})


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Our own ``near`` model, written."""
    config = checked_config(SMALL)
    tables = build_radio_map(config)
    write_channels(tmp_path / "near.npz", config, tables.direct, tables.reflected)
    return tmp_path / "near.npz"


@pytest.fixture
def changed(file: Path) -> Callable[..., Path]:
    """Writes the file anew, some arrays changed or (None) left out."""

    def write(**arrays: Any) -> Path:
        content = {**np.load(file)} | arrays
        np.savez(file, **{name: array for name, array in content.items() if array is not None})
        return file

    return write


def say(path: Path, **changes: Any) -> str:
    """What is said of a file that does not fit, a sentence."""
    with pytest.raises(PluginError) as error:
        build_radio_map(from_file(path, **changes))
    start = f"env.channel.file={path}: allowed is "
    assert str(error.value).startswith(start)
    assert "\n" not in str(error.value)
    return str(error.value).removeprefix(start)


def test_our_own_model_comes_back_bit_for_bit(file: Path) -> None:
    ours, read = build_radio_map(checked_config(SMALL)), build_radio_map(from_file(file))
    for name in ("direct", "reflected", "settings", "direct_db", "direct_los", "ris_los"):
        assert np.array_equal(getattr(ours, name), getattr(read, name)), name


@pytest.mark.parametrize("fading", ["static", "none", "slot"])
def test_rates_are_those_of_the_model_that_was_written(tmp_path: Path, fading: str) -> None:
    config = checked_config({**SMALL, "channel": {"fading": fading}})
    tables, path = build_radio_map(config), tmp_path / "any.npz"
    write_channels(path, config, tables.direct, tables.reflected)
    rates = []
    for each in (config, from_file(path, channel={"fading": fading})):
        world = World(Scenario.drawn(each, 0), np.random.default_rng(5), worlds=8)
        world.reset()
        moves = np.random.default_rng(6)
        for _ in range(5):
            phase, level = moves.integers(16, size=8), moves.integers(1, 7, size=(8, 2))
            rates.append(world.step(phase, moves.integers(4, size=(8, 2)), level).rate)
    assert np.array_equal(rates[:5], rates[5:])
    assert np.count_nonzero(rates) > 0


def test_the_same_channels_make_the_same_bytes(file: Path, tmp_path: Path) -> None:
    config, before = checked_config(SMALL), file.read_bytes()
    tables = build_radio_map(config)
    write_channels(tmp_path / "again.npz", config, tables.direct, tables.reflected)
    assert (tmp_path / "again.npz").read_bytes() == before


def test_without_a_surface_its_channels_do_not_count(file: Path) -> None:
    tables = build_radio_map(from_file(file, ris={**SMALL["ris"], "side": 0, "response": "far"}))
    assert not tables.reflected.any()
    assert tables.direct.all()


def test_a_hand_made_file_needs_no_more_than_channels_cells_and_units(
    changed: Callable[..., Path],
) -> None:
    path = changed(made_for=None, note=np.array("measured in May"))
    moved = {**SMALL["ris"], "position_m": [6.0, 1.5, 2.0]}
    assert problems(from_file(path, ris=moved)) == []


@pytest.mark.parametrize(
    ("arrays", "expected"),
    [
        ({"direct": None}, "a file with the arrays direct, reflected, cells_m, units, and not"),
        ({"units": np.array("dB, m")}, "a file whose units are 'amplitude, m', and not dB, m"),
        ({"units": np.array(["amplitude, m"])}, "a file whose units are 'amplitude, m'"),
        ({"direct": np.ones(96)}, "complex, and not float64"),
        ({"direct": np.full(95, 0.1j)}, "of shape (96,), a channel for each cell, and not (95,)"),
        ({"direct": np.full(96, np.nan + 0j)}, "finite everywhere, and not (nan+0j) in cell 0"),
        ({"direct": np.full(96, -80 + 0j)}, "up to 1, as no link amplifies, and not (-80+0j)"),
        ({"direct": np.zeros(96, complex)}, "direct is nowhere zero, and not in cell 0"),
        (
            {"reflected": np.zeros((96, 4), complex)},
            "of shape (96, 2), for each cell env.ris.subsurfaces=2 channels, and not (96, 4)",
        ),
        ({"cells_m": np.zeros((24, 2))}, "x and y of the 96 cells of the floor of 6 m x 4 m"),
        ({"cells_m": np.zeros((96, 2))}, "row by row from the origin: cell 0 is at 0.25,0.25"),
        ({"cells_m": np.full((96, 2), np.nan)}, "cell 0 is at 0.25,0.25, and not nan,nan"),
        ({"made_for": np.array("{")}, "a file whose made_for is JSON"),
        ({"made_for": np.array('{"seed": 1}')}, "a file whose made_for is a mapping of some of"),
        (
            {"made_for": np.array(json.dumps({"ap.position_m": [0, 0, 2]}))},
            "a file made for env.ap.position_m=[3.0, 4.0, 2.0], and not for [0, 0, 2]",
        ),
        ({"direct": np.array([{}] * 96)}, "a whole NumPy archive of numbers and texts ("),
    ],
)
def test_what_does_not_fit_is_named_with_what_is_found_and_what_is_expected(
    changed: Callable[..., Path], arrays: dict[str, Any], expected: str
) -> None:
    path = changed(**arrays)
    assert expected in say(path)
    assert [key for key, _, _ in problems(from_file(path))] == ["env.channel.file"]


def test_files_that_are_none_are_named(tmp_path: Path, file: Path) -> None:
    assert "a file that can be read (No such file" in say(tmp_path / "missing.npz")
    assert "a file that can be read (Is a directory" in say(tmp_path)
    torn = tmp_path / "torn.npz"
    torn.write_bytes(file.read_bytes()[:-30])
    assert "a NumPy archive (.npz), which these" in say(torn)
    np.save(tmp_path / "one.npy", np.zeros(3))
    assert "a NumPy archive (.npz), which these" in say(tmp_path / "one.npy")
    damaged = bytearray(file.read_bytes())
    damaged[200:210] = b"0123456789"
    torn.write_bytes(damaged)
    assert "a whole NumPy archive" in say(torn)


def test_another_plans_file_and_another_one_than_the_runs_are_refused(file: Path) -> None:
    assert "x and y of the 48 cells of the floor of 6 m x 2 m" in say(
        file,
        room={"width_m": 6.0, "depth_m": 2.0},
        ap={"position_m": [3.0, 2.0, 2.0]},
        walls={"segments": []},
        tasks={"destinations_m": [[1.25, 1.25], [5.25, 1.25]], "start_distance_m": 1.0},
    )
    found = say(file, channel={"sha256": "0" * 64})
    assert found.startswith(f"the file whose SHA-256 is {'0' * 64}, with which the run began")


@pytest.mark.parametrize(
    ("channel", "expected"),
    [
        ({"model": "file"}, "env.channel.file=None: allowed is the path of a file of channels"),
        ({"file": "x.npz"}, "env.channel.file='x.npz': allowed is null with env.channel.model=ind"),
        ({"sha256": "0" * 64}, "allowed is null with env.channel.model=indoor_hotspot"),
        ({"model": "file", "file": "x", "sha256": "ABC"}, "null, or 64 hexadecimal digits"),
    ],
)
def test_keys_that_do_not_go_together_are_refused(channel: dict[str, Any], expected: str) -> None:
    with pytest.raises(ValueError, match=r"env\.channel") as error:
        checked_config({**SMALL, "channel": channel})
    assert expected in str(error.value)


def test_nothing_is_written_that_could_not_be_read(tmp_path: Path) -> None:
    config = checked_config(SMALL)
    tables = build_radio_map(config)
    with pytest.raises(PluginError, match="of shape \\(96, 2\\)"):
        write_channels(tmp_path / "x.npz", config, tables.direct, tables.reflected[:, :1])
    assert not (tmp_path / "x.npz").exists()


def test_a_robots_side_needs_no_file(tmp_path: Path) -> None:
    mine = Scenario.drawn(from_file(tmp_path / "missing.npz"), 0).of([1])
    seen = mine.local_states(np.array([[3]]), np.array([[-70.0]], dtype=np.float32))
    assert seen.shape[:2] == (1, 1)


def test_the_name_file_is_no_plug_ins() -> None:
    ours = np.ones(96, complex), np.ones((96, 2), complex)
    with pytest.raises(PluginError, match="a name other than indoor_hotspot and file"):
        plugins.register_channel_model("file", lambda config, floor: ours)
