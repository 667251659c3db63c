"""Runs that died, cut out of runs that did not, and what they come to when they go on."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from experiments.cli import main
from tools.chaos.verdict import differences
from training.run_folder import RunFolder


def summary(folder: Path) -> dict[str, Any]:
    return RunFolder(folder).read_summary()


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
    assert differences(folder, whole) == []
    for key in keys:
        assert summary(folder)[key] == summary(whole)[key], key


def check_goes_on(whole: Path, window: int, *keys: str) -> None:
    """Checks that a run that died after a window ends as the one that did not, keys included."""
    folder = rewound(whole, whole.with_name("died"), window)
    assert main(["train", f"resume={folder}"]) == 0
    check_same(folder, whole, *keys)
