"""A file of weights says what it is, and is enough to play them; older ones are read as before."""

from __future__ import annotations

import dataclasses
import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.numpy import load, load_file, save, save_file

from conf import Config, ConfigError, compose
from conf.schema import RunConfig, RuntimeConfig
from experiments.cli import main
from storage.safetensors_metadata import read_metadata, with_metadata
from training.run_folder import RunFolder
from training.weights_metadata import config_in, describe

TEXTS = st.dictionaries(st.text(max_size=20), st.text(max_size=200), max_size=5)
ARRAYS = {"robots": np.arange(12, dtype=np.float32).reshape(3, 4), "ap": np.zeros(0, np.float32)}


def arrays_of(folder: Path) -> dict[str, Any]:
    return load_file(folder / "weights.safetensors")


# --- What a file says -----------------------------------------------------------------------------


def test_the_weights_of_a_run_say_what_they_are(tiny_run: Path) -> None:
    said = read_metadata(tiny_run / "weights.safetensors")
    summary = json.loads((tiny_run / "summary.json").read_text())
    assert (said["format"], said["format_version"]) == ("risfleet-weights", "1")
    assert said["risfleet_version"] == summary["versions"]["risfleet"]
    assert (said["robots"], said["plan"]) == ("3", "default")
    assert said["robots_network"] == "5 - 13 - 11 - 24"
    assert said["ap_network"].endswith(" - 13 - 11 - 4")
    digests = {"robots": said["robots_sha256"], "ap": said["ap_sha256"]}
    assert digests == summary["digest"]


def test_the_weights_of_a_room_say_which_room_it_is(building_run: Path) -> None:
    for path in (building_run / "rooms").iterdir():
        place = RunFolder(path)
        found = config_in(read_metadata(place.weights_file))
        assert found is not None
        assert found.env == place.read_config().env


def test_where_a_run_was_is_left_out(tiny: Callable[..., Config], tiny_run: Path) -> None:
    config = RunFolder(tiny_run).read_config()
    assert config.run.dir is not None
    arrays = arrays_of(tiny_run)
    said = describe(config, arrays["robots"], arrays["ap"])
    assert not any(config.run.dir in text for text in said.values())
    assert said == describe(tiny(), arrays["robots"], arrays["ap"])


@pytest.mark.parametrize(
    "overrides",
    [
        (),
        ("env.plan=hall", "env.robots=2"),
        ("experiment=best", "strategy=fedadam"),
        ("baseline=qoe", "agent.hidden=[7]", "seed=5"),
    ],
)
def test_the_overrides_make_the_configuration_again(overrides: tuple[str, ...]) -> None:
    config = compose(overrides)
    nothing = np.zeros((1, 2, 0), np.float32)
    said = describe(config, nothing, nothing[0])
    elsewhere = dataclasses.replace(config, run=RunConfig(), runtime=RuntimeConfig())
    assert config_in(said) == elsewhere
    again = compose(["runtime=local", *shlex.split(said["overrides"])])
    assert dataclasses.replace(again, run=RunConfig()) == elsewhere


@given(texts=TEXTS, others=TEXTS)
def test_metadata_read_back_and_leave_arrays_as_they_were(
    texts: dict[str, str], others: dict[str, str]
) -> None:
    content = with_metadata(with_metadata(save(ARRAYS, others), others), texts)
    assert content == with_metadata(save(ARRAYS), texts)
    found = load(content)
    assert {name: array.tolist() for name, array in found.items()} == {
        name: array.tolist() for name, array in ARRAYS.items()
    }
    length = int.from_bytes(content[:8], "little")
    assert length % 8 == 0
    assert json.loads(content[8 : 8 + length])["__metadata__"] == texts


def test_the_library_reads_what_is_written(tmp_path: Path) -> None:
    path = tmp_path / "some.safetensors"
    path.write_bytes(with_metadata(save(ARRAYS), {"one": "1", "ä": "\n\0"}))
    with safe_open(path, framework="np") as file:
        assert file.metadata() == {"one": "1", "ä": "\n\0"}
        assert file.get_tensor("robots").tolist() == ARRAYS["robots"].tolist()


# --- The file alone, and older ones ---------------------------------------------------------------


def test_a_file_of_weights_is_played_without_any_other(tiny_run: Path, tmp_path: Path) -> None:
    alone = tmp_path / "alone" / "weights.safetensors"
    alone.parent.mkdir()
    alone.write_bytes((tiny_run / "weights.safetensors").read_bytes())
    for name, what in (("whole", tiny_run), ("file", alone), ("folder", alone.parent)):
        assert main(["evaluate", str(what), "--json", str(tmp_path / f"{name}.json")]) == 0
    whole, file, folder = (
        (tmp_path / f"{name}.json").read_text() for name in ("whole", "file", "folder")
    )
    assert whole == file == folder


def test_weights_without_metadata_are_read_as_before(tiny_run: Path, tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    config = RunFolder(tiny_run).read_config()
    save_file(arrays_of(tiny_run), folder.weights_file)
    assert folder.read_networks(config)[0].tolist() == arrays_of(tiny_run)["robots"].tolist()
    with pytest.raises(ConfigError, match=r"is no run folder: config\.yaml cannot be read"):
        folder.read_config()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"format_version": "2"}, "the weights are of format 2: allowed is 1."),
        ({"config": "env: {robots: -1}"}, r"env.robots=-1: allowed is"),
        ({"config": "[1"}, "the configuration is no YAML"),
    ],
)
def test_metadata_that_do_not_fit_are_said_in_a_sentence(
    tiny_run: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    changes: dict[str, str],
    said: str,
) -> None:
    content = (tiny_run / "weights.safetensors").read_bytes()
    metadata = read_metadata(tiny_run / "weights.safetensors")
    alone = tmp_path / "weights.safetensors"
    alone.write_bytes(with_metadata(content, metadata | changes))
    assert main(["evaluate", str(alone)]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("content", [b"", b"\xff" * 40, None])
def test_what_is_no_file_of_weights_has_no_metadata(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "weights.safetensors"
    if content is not None:
        path.write_bytes(content)
    assert read_metadata(path) == {}
