"""What a target's files came from: ``<target>.manifest.json`` beside them."""

from __future__ import annotations

import hashlib
import json
import platform
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from conf import fingerprint, version
from experiments.reproduce.results.runs import Run
from experiments.reproduce.targets.plan import Cell
from storage.atomic import write_atomically

KEPT = ("digest", "ticks", "episodes", "wall_s", "cpu_s")
"""Of a run's summary."""

DISTRIBUTIONS = ("risfleet", "torch", "numpy", "flwr", "hydra-core", "matplotlib")


def write(
    out: Path,
    target: str,
    cells: Sequence[Cell],
    runs: Mapping[str, Mapping[int, Run]],
    files: Sequence[Path],
    call: Mapping[str, Any],
) -> Path:
    """Writes the manifest of a target's files beside them; returns it.

    ``call`` says how it was called: what the user set, and the seconds that it took.
    """
    manifest = {
        "target": target,
        **call,
        "commit": commit(),
        "fingerprint": fingerprint(),
        "versions": {"python": platform.python_version()}
        | {name: version(name) for name in DISTRIBUTIONS},
        "cells": {cell.name: _cell(cell, runs[cell.name], out) for cell in cells},
        "cpu_s": sum(run.summary["cpu_s"] for each in runs.values() for run in each.values()),
        "files": {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files},
    }
    path = out / f"{target}.manifest.json"
    write_atomically(path, json.dumps(manifest, indent=2) + "\n")
    return path


def _cell(cell: Cell, runs: Mapping[int, Run], out: Path) -> dict[str, Any]:
    seeds = {}
    for seed, run in runs.items():
        measures = {key: run.summary[key] for key in KEPT}
        seeds[str(seed)] = {"folder": str(run.folder.relative_to(out.absolute())), **measures}
    return {"overrides": list(cell.overrides), "seeds": seeds}


def commit() -> str | None:
    """The commit of the program, "+" after it if files were changed since; None if unknown."""
    root = Path(__file__).parent.parent.parent.parent
    describe = ("describe", "--always", "--exclude=*", "--abbrev=40", "--dirty=+")
    try:
        for command in (("ls-files", "--error-unmatch", "pyproject.toml"), describe):
            said = subprocess.run(
                ["git", "-C", str(root), *command], capture_output=True, text=True, check=True
            ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
    return said
