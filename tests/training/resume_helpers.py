"""Runs that died, cut out of runs that did not, and what they come to when they go on."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from typing import Any

from experiments.cli import main


def summary(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "summary.json").read_text())


def rows(path: Path) -> list[dict[str, str]]:
    """A CSV file's rows without the clocks."""
    with path.open() as file:
        return [{k: v for k, v in row.items() if k != "cpu_s"} for row in csv.DictReader(file)]


def rewound(whole: Path, folder: Path, window: int) -> Path:
    """A copy of a run as if it had died after the checkpoint of a window, but before the next."""
    shutil.copytree(whole, folder)
    written = {
        path: int(path.stem.removeprefix("checkpoint-"))
        for path in (folder / "state").rglob("checkpoint-*.safetensors")
    }
    assert min(written.values()) <= window < max(written.values())
    for path in (path for path, at in written.items() if at > window):
        path.unlink()
    for name in ("summary.json", "weights.safetensors"):
        (folder / name).unlink()
    return folder


def check_same(folder: Path, whole: Path, *keys: str) -> None:
    """Checks that two runs came to the same weights, records and results."""
    for key in ("digest", "ticks", "windows", "episodes", "evaluation", *keys):
        assert summary(folder)[key] == summary(whole)[key], key
    for name in ("metrics.csv", "evaluations.csv"):
        assert rows(folder / name) == rows(whole / name)


def check_goes_on(whole: Path, window: int, *keys: str) -> None:
    """Checks that a run that died after a window ends as the one that did not, keys included."""
    folder = rewound(whole, whole.with_name("died"), window)
    assert main(["train", f"resume={folder}"]) == 0
    check_same(folder, whole, *keys)
