"""What the tests of ``risfleet reproduce`` share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from experiments.cli import main


def without_a_targets_own(tiny_overrides: Sequence[str]) -> list[str]:
    """The tiny task without what a target sets itself."""
    own = ("run.", "runtime", "train.max_ticks")
    return [item for item in tiny_overrides if not item.startswith(own)]


def reproduce_quickly(target: str, out: Path, tiny_overrides: Sequence[str], *keys: str) -> None:
    """Makes a quick target of the tiny task, with ``keys`` on top, in this process."""
    command = ["reproduce", target, "--quick", "--out", str(out), "hydra/launcher=basic"]
    assert main([*command, *without_a_targets_own(tiny_overrides), *keys]) == 0
