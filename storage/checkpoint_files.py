"""Checkpoints on disk: one safetensors file each, with its metadata as JSON in the header.

A checkpoint appears whole or not at all: it is written beside its place, flushed, renamed, and
its folder flushed. A digest in the header shows later damage. Nothing is ever unpickled.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from storage.atomic import write_whole

Json = None | bool | int | float | str | list["Json"] | dict[str, "Json"]
Arrays = dict[str, NDArray[np.generic]]

KEPT = 3
"""One more than two: a side may be a write behind the others when all of them die."""
_NAME = re.compile(r"checkpoint-(\d{12})\.safetensors")


class CheckpointError(Exception):
    """A checkpoint that is missing, cut short, changed or another's."""


def digest(weights: NDArray[np.floating]) -> str:
    """SHA-256, 64 hexadecimal digits, of weights of any shape as little-endian float32, C order."""
    return hashlib.sha256(np.ascontiguousarray(weights, "<f4").tobytes()).hexdigest()


def arrays_digest(arrays: Mapping[str, NDArray[np.generic]]) -> str:
    """SHA-256, 64 hexadecimal digits, over names, types, shapes and bytes, in whatever order."""
    return _sealed(hashlib.sha256(), arrays)


def save_checkpoint(
    folder: Path,
    step: int,
    arrays: Mapping[str, NDArray[np.generic]],
    meta: Mapping[str, Json],
    kept: int = KEPT,
) -> Path:
    """Writes a checkpoint atomically and drops those before the last few.

    Checkpoints of later steps, left by a run that went back, stay.

    Args:
        folder: made if need be.
        step: at least 0; an existing checkpoint of that step is replaced.
        arrays: by name.
        meta: anything JSON can hold.
        kept: how many stay, of this step and earlier ones.

    Returns:
        The file.

    Raises:
        OSError: it cannot be written; those that were there stay. The message names the file.
    """
    contiguous = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    text = json.dumps(dict(meta), sort_keys=True, allow_nan=False)
    path = _path(folder, step)
    content = save(contiguous, {"meta": text, "sha256": _seal(step, contiguous, text)})
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(path, content)
    for old in [s for s in checkpoints(folder) if s <= step][:-kept]:
        _path(folder, old).unlink(missing_ok=True)
    return path


def drop_between(folder: Path, after: int, before: int) -> None:
    """Drops checkpoints of steps that a run has gone back from, both ends excluded.

    What a side wrote in vain would otherwise count among those that are kept, and push the one
    that it goes back to out.

    Args:
        folder: where they were saved.
        after: the step that a side went back to.
        before: the step that it has now come to.
    """
    for step in checkpoints(folder):
        if after < step < before:
            _path(folder, step).unlink(missing_ok=True)


class Writer:
    """Writes checkpoints one after the other, beside the work that goes on.

    An error of a write comes out of the next call, or of `wait`.
    """

    def __init__(self) -> None:
        """A writer with nothing to do."""
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="checkpoints")
        self._pending: list[Future[Path]] = []

    def save(
        self,
        folder: Path,
        step: int,
        arrays: Mapping[str, NDArray[np.generic]],
        meta: Mapping[str, Json],
    ) -> None:
        """As `save_checkpoint`, and returns at once; arrays must not change until it is done."""
        self._pending.append(self._pool.submit(save_checkpoint, folder, step, arrays, meta))

    def wait(self) -> None:
        """Returns once all is on disk; an OSError where a checkpoint cannot be written."""
        pending, self._pending = self._pending, []
        for write in pending:
            write.result()

    def close(self) -> None:
        """Waits and ends the thread."""
        try:
            self.wait()
        finally:
            self._pool.shutdown()


def checkpoints(folder: Path) -> list[int]:
    """Steps of the checkpoints in a folder, ascending; none if there is no such folder."""
    if not folder.is_dir():
        return []
    return sorted(int(m[1]) for m in map(_NAME.fullmatch, os.listdir(folder)) if m)


def load_checkpoint(
    folder: Path, step: int, owner: Mapping[str, Json] | None = None
) -> tuple[Arrays, dict[str, Json]]:
    """Reads a checkpoint.

    Args:
        folder: where it was saved.
        step: which.
        owner: values that its metadata must not contradict, such as whose it is.

    Returns:
        Its arrays and its metadata.

    Raises:
        CheckpointError: it is missing, cut short, changed or another's; others are not affected.
    """
    path = _path(folder, step)
    try:
        with safe_open(path, framework="np") as file:
            header = file.metadata() or {}
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except FileNotFoundError as error:
        raise CheckpointError(f"there is no checkpoint {path}") from error
    except (SafetensorError, OSError) as error:
        raise CheckpointError(f"checkpoint {path} is cut short or damaged: {error}") from error
    text = header.get("meta", "")
    if header.get("sha256") != _seal(step, arrays, text):
        raise CheckpointError(f"checkpoint {path} was changed: its digest does not match")
    meta: dict[str, Json] = json.loads(text)
    for name, value in (owner or {}).items():
        if meta.get(name, value) != value:
            raise CheckpointError(
                f"checkpoint {path} is that of {name} {meta[name]}, not of {name} {value}"
            )
    return arrays, meta


def _path(folder: Path, step: int) -> Path:
    return folder / f"checkpoint-{step:012d}.safetensors"


def _seal(step: int, arrays: Mapping[str, NDArray[np.generic]], meta: str) -> str:
    """SHA-256 over step, metadata, and every array's name, type, shape and bytes."""
    return _sealed(hashlib.sha256(f"{step}\n{meta}\n".encode()), arrays)


def _sealed(seal: hashlib._Hash, arrays: Mapping[str, NDArray[np.generic]]) -> str:
    for name in sorted(arrays):
        array = arrays[name]
        seal.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        seal.update(array.reshape(-1).view(np.uint8).data)  # in place: replays are large
    return seal.hexdigest()
