"""What the tests of ``risfleet reproduce`` share."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from experiments.cli import main
from experiments.reproduce.results import cost
from experiments.reproduce.results.runs import Run, Runs


def without_a_targets_own(tiny_overrides: Sequence[str]) -> list[str]:
    """The tiny task without what a target sets itself."""
    own = ("run.", "runtime", "train.max_ticks")
    return [item for item in tiny_overrides if not item.startswith(own)]


def reproduce_quickly(target: str, out: Path, tiny_overrides: Sequence[str], *keys: str) -> None:
    """Makes a quick target of the tiny task, with ``keys`` on top, in this process."""
    command = ["reproduce", target, "--quick", "--out", str(out), "hydra/launcher=basic"]
    assert main([*command, *without_a_targets_own(tiny_overrides), *keys]) == 0


def same_run(target: Any, folder: Path, seeds: Sequence[int] = (0,)) -> Runs:
    """The same run in every cell of a quick target, as if it were of several seeds."""
    return {cell.name: dict.fromkeys(seeds, Run(folder)) for cell in target.cells(quick=True)}


def rows_of(file: Path) -> list[dict[str, str]]:
    """The rows of a CSV file."""
    with file.open(newline="") as text:
        return list(csv.DictReader(text))


def measure_shortly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets the processor time of gradient steps be measured over few of them."""
    for name, value in (("BLOCKS", 2), ("CENTRAL_STEPS", 2), ("FEDERATED_STEPS", 4)):
        monkeypatch.setattr(cost, name, value)
