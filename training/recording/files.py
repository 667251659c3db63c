"""The files of a run's folder: each is whole whenever it is read."""

from __future__ import annotations

import csv
import io
import json
import os
import time
from collections.abc import Mapping
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save

from storage.atomic import naming, write_atomically, write_whole
from storage.checkpoint_files import CheckpointError


def report_failure(folder: Path, error: BaseException) -> None:
    """Writes to a run's ``progress.json`` that it failed, and why; a first failure stands."""
    with suppress(OSError):  # of a full disk: the error that stands is the first
        report_state(folder, "failed", f"{type(error).__name__}: {error}")


def report_state(folder: Path, state: str, message: str) -> None:
    """Writes to a run's ``progress.json`` what has become of it; a failure stands.

    Raises:
        OSError: the file cannot be written.
    """
    path = folder / "progress.json"
    status: dict[str, Any] = {}
    with suppress(OSError, ValueError, TypeError):  # not yet there, or damaged
        status |= json.loads(path.read_text(encoding="utf-8-sig"))
    if status.get("state") == "failed":
        return
    status |= {"state": state, "message": message, "written_at": time.time()}
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(status))


def save_weights(path: Path, robots: NDArray[np.float32], ap: NDArray[np.float32]) -> None:
    """Writes the final weights: ``robots`` (K, 2, P) and ``ap`` (2, P_AP), online then target."""
    arrays = {"robots": np.ascontiguousarray(robots), "ap": np.ascontiguousarray(ap)}
    write_whole(path, save(arrays))


def to_json(values: dict[str, Any]) -> str:
    """Values as strict JSON: what is not a finite number becomes null."""
    return json.dumps(finite(values), indent=2) + "\n"


def finite(value: Any) -> Any:
    """Values as JSON has them: what is not a finite number becomes None."""
    if isinstance(value, dict):
        return {key: finite(inner) for key, inner in value.items()}
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


class CsvLog:
    """A CSV file of numbers that grows by a row at a time.

    Args:
        path: the file.
        columns: the names of its columns.
        kept: rows of an earlier file that stay; what follows them was undone by a resume.

    Attributes:
        kept: those rows.
    """

    def __init__(self, path: Path, columns: tuple[str, ...], kept: int = 0) -> None:
        self.kept = _read_rows(path, kept) if kept else []
        text = io.StringIO(newline="")
        whole = csv.DictWriter(text, columns)
        whole.writeheader()
        whole.writerows(self.kept)
        write_atomically(path, text.getvalue())
        self._path, self._file = path, path.open("a", encoding="utf-8", newline="")
        self._writer = csv.DictWriter(self._file, columns, extrasaction="ignore")

    def write(self, row: dict[str, float]) -> None:
        """Adds a row; columns that it lacks stay empty."""
        with naming(self._path):
            self._writer.writerow(row)
            self._file.flush()

    def sync(self) -> None:
        """Waits until all rows outlast a crash of the machine."""
        with naming(self._path):
            self._file.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Closes the file, which holds every row that could be written."""
        with suppress(OSError):  # of a full disk, which `write` has told already
            self._file.close()


def check_files(folder: Path, marks: Mapping[str, Any]) -> None:
    """Finds before a run goes on that its files hold what its checkpoint says.

    Raises:
        CheckpointError: a file is missing or shorter.
    """
    _read_rows(folder / "metrics.csv", marks["episodes"])
    _read_rows(folder / "evaluations.csv", 2 * marks["evaluations"])


def _read_rows(path: Path, count: int) -> list[dict[str, float]]:
    """The first rows of a CSV file of numbers; whole numbers stay whole.

    Raises:
        CheckpointError: there are fewer.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(islice(csv.DictReader(file), count))
    except FileNotFoundError:
        rows = []
    if len(rows) < count:
        raise CheckpointError(f"{path} has {len(rows)} rows where the checkpoint has {count}")
    return [{name: _number(text) for name, text in row.items()} for row in rows]


def _number(text: str) -> float:
    return int(text) if text.isdecimal() else float(text)
