"""Checkpoints are whole or absent, and damage is seen."""

import os
from contextlib import suppress

import numpy as np
import pytest
from agent_helpers import Experience, fleet, live, same_bits, shape_of, small_config

from storage.checkpoint_files import (
    CheckpointError,
    checkpoints,
    digest,
    load_checkpoint,
    save_checkpoint,
)

ARRAYS: dict[str, np.ndarray] = {
    "a": np.arange(6, dtype=np.float32).reshape(2, 3),
    "b": np.array([2**63], np.uint64),
}
META = {"seed": 7, "names": ["x", "y"], "none": None}


def test_arrays_and_metadata_come_back(tmp_path):
    path = save_checkpoint(tmp_path / "new" / "folder", 3, ARRAYS, META)
    assert path.exists()
    arrays, meta = load_checkpoint(path.parent, 3)
    assert meta == META
    assert arrays.keys() == ARRAYS.keys()
    for name in ARRAYS:
        assert arrays[name].dtype == ARRAYS[name].dtype
        np.testing.assert_array_equal(arrays[name], ARRAYS[name])


def test_agents_go_on_from_disk_to_the_same_bits(tmp_path):
    config = small_config()
    shape = shape_of(config)
    experience = Experience(shape, 2, 120)
    agents = fleet(shape, config, [1, 2])
    live(agents, experience, range(2), stop=60)
    save_checkpoint(tmp_path, 60, agents.state(), {})
    live(agents, experience, range(2), start=60)
    resumed = fleet(shape, config, [8, 9])
    resumed.restore(load_checkpoint(tmp_path, 60)[0])
    live(resumed, experience, range(2), start=60)
    assert digest(resumed.weights()) == digest(agents.weights())


def test_the_last_three_checkpoints_are_kept(tmp_path):
    for step in (1, 20, 300, 4000):
        save_checkpoint(tmp_path, step, ARRAYS, {})
    assert checkpoints(tmp_path) == [20, 300, 4000]
    assert sorted(os.listdir(tmp_path)) == [
        "checkpoint-000000000020.safetensors",
        "checkpoint-000000000300.safetensors",
        "checkpoint-000000004000.safetensors",
    ]


def test_going_back_keeps_what_a_resume_could_need(tmp_path):
    for step in (20, 40, 30):
        save_checkpoint(tmp_path, step, ARRAYS, {})
    assert checkpoints(tmp_path) == [20, 30, 40]


def test_an_unknown_folder_holds_no_checkpoints(tmp_path):
    assert checkpoints(tmp_path / "none") == []
    with pytest.raises(CheckpointError, match="there is no checkpoint"):
        load_checkpoint(tmp_path, 5)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_truncated_checkpoint_is_refused_and_the_older_one_stands(tmp_path, share):
    save_checkpoint(tmp_path, 1, ARRAYS, META)
    path = save_checkpoint(tmp_path, 2, ARRAYS, META)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(CheckpointError, match="cut short or damaged"):
        load_checkpoint(tmp_path, 2)
    assert load_checkpoint(tmp_path, 1)[1] == META


@pytest.mark.parametrize("what", ["array", "metadata", "step"])
def test_a_changed_checkpoint_is_refused(tmp_path, what):
    path = save_checkpoint(tmp_path, 1, ARRAYS, META)
    content = bytearray(path.read_bytes())
    if what == "array":
        content[-3] ^= 1
    elif what == "metadata":
        content = content.replace(b'\\"seed\\": 7', b'\\"seed\\": 8')
    else:
        path = path.with_name("checkpoint-000000000002.safetensors")
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match="was changed"):
        load_checkpoint(tmp_path, 2 if what == "step" else 1)


def test_a_crash_while_writing_leaves_the_older_checkpoint(tmp_path, monkeypatch):
    save_checkpoint(tmp_path, 1, ARRAYS, META)

    def crash(_handle):
        raise OSError("the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr("storage.checkpoint_files.os.fsync", crash)
        with pytest.raises(OSError, match="disk is full"):
            save_checkpoint(tmp_path, 2, ARRAYS, META)
    assert checkpoints(tmp_path) == [1]
    assert load_checkpoint(tmp_path, 1)[1] == META
    save_checkpoint(tmp_path, 2, ARRAYS, META)
    assert checkpoints(tmp_path) == [1, 2]


def test_what_cannot_be_written_names_the_file_and_leaves_nothing_of_it(tmp_path, monkeypatch):
    def full(_handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("storage.checkpoint_files.os.fsync", full)
    with pytest.raises(OSError, match=r"No space left on device: '.*checkpoint-0*2\.safetensors'"):
        save_checkpoint(tmp_path, 2, ARRAYS, META)
    assert os.listdir(tmp_path) == []


def test_any_byte_that_is_changed_is_seen_or_changes_nothing(tmp_path):
    path = save_checkpoint(tmp_path, 1, ARRAYS, META)
    whole = path.read_bytes()
    for place in range(len(whole)):
        damaged = bytearray(whole)
        damaged[place] ^= (0x01, 0x20, 0x80)[place % 3]
        path.write_bytes(damaged)
        with suppress(CheckpointError):
            arrays, meta = load_checkpoint(tmp_path, 1)
            assert meta == META
            assert all(np.array_equal(arrays[name], ARRAYS[name]) for name in ARRAYS)


def test_a_checkpoint_of_another_owner_is_refused(tmp_path):
    save_checkpoint(tmp_path, 1, ARRAYS, {"run": "a", "robot": 2})
    assert load_checkpoint(tmp_path, 1, {"run": "a", "robot": 2})
    assert load_checkpoint(tmp_path, 1, {"not": "said"})
    with pytest.raises(CheckpointError, match=r"is that of robot 2, not of robot 1"):
        load_checkpoint(tmp_path, 1, {"run": "a", "robot": 1})


def test_a_digest_reads_values_in_order_whatever_the_layout():
    weights = np.arange(6, dtype=np.float32).reshape(2, 3)
    assert digest(weights) == digest(np.asfortranarray(weights)) == digest(weights.astype(">f4"))
    assert digest(weights) != digest(weights[::-1])
    assert same_bits(weights, np.arange(6, dtype="<f4"))
