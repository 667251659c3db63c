"""The CSV files of a run: they grow by a row at a time, and a resumed run takes rows back."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.atomic import naming, write_atomically
from storage.checkpoint_files import CheckpointError
from training.run_folder import RunFolder


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


def check_files(folder: RunFolder, marks: Mapping[str, Any]) -> None:
    """Raises a ``CheckpointError`` where a run's files do not hold what its checkpoint says."""
    _read_rows(folder.metrics_file, marks["episodes"])
    _read_rows(folder.evaluations_file, 2 * marks["evaluations"])
    _read_rows(folder.rooms_log_file, marks.get("rooms", 0))


def _read_rows(path: Path, count: int) -> list[dict[str, float]]:
    """The first rows of a CSV file of numbers; whole numbers stay whole."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(islice(csv.DictReader(file), count))
    except FileNotFoundError:
        rows = []
    if len(rows) < count:
        raise CheckpointError(f"{path} has {len(rows)} rows where the checkpoint has {count}")
    return [{name: _number(text) for name, text in row.items()} for row in rows]


def read_columns(path: Path) -> dict[str, NDArray[Any]]:
    """The columns of a CSV file of numbers, which may still grow; whole numbers stay whole.

    Returns:
        By name, each of shape (rows,); nan where a value is missing.

    Raises:
        OSError: it cannot be read.
        ValueError: something in it is no number.
    """
    text = path.read_text(encoding="utf-8-sig")
    rows = csv.DictReader(io.StringIO(text[: text.rfind("\n") + 1], newline=""))
    columns: dict[str, list[float]] = {name: [] for name in rows.fieldnames or ()}
    for row in rows:
        for name, values in columns.items():
            values.append(_number(row[name] or "nan"))
    return {name: np.array(values) for name, values in columns.items()}


def _number(text: str) -> float:
    return int(text) if text.isdecimal() else float(text)
