"""Whether a run ended as one that nobody disturbed."""

from __future__ import annotations

import csv
import re
from pathlib import Path

from safetensors.numpy import load_file

from storage.checkpoint_files import CheckpointError, checkpoints, digest, load_checkpoint
from tools.chaos.kill_points import read_json

CLOCKS = ("cpu_s",)


def has_ended(folder: Path) -> bool:
    """Whether a run has written all that it leaves behind."""
    return all((folder / name).is_file() for name in ("summary.json", "weights.safetensors"))


def differences(folder: Path, reference: Path) -> list[str]:
    """What a finished run has otherwise than the reference, a sentence each; none if nothing.

    Args:
        folder: of the run.
        reference: the folder of a run of the same task that nobody disturbed.
    """
    found = []
    mine, other = (read_json(path / "summary.json") for path in (folder, reference))
    for key in ("digest", "ticks", "windows", "episodes", "evaluation"):
        if key not in mine or mine[key] != other[key]:
            found.append(f"summary.json: {key} is {mine.get(key)}, not {other[key]}")
    arrays = load_file(folder / "weights.safetensors")
    if {name: digest(array) for name, array in arrays.items()} != other["digest"]:
        found.append("weights.safetensors: not the weights of the reference")
    for name in ("metrics.csv", "evaluations.csv"):
        rows, due = rows_of(folder / name), rows_of(reference / name)
        if rows != due:
            episodes = [row["episode"] for row in rows]
            found.append(f"{name}: {len(rows)} rows, not the {len(due)} due: episodes {episodes}")
    return found + damaged(folder / "state")


def damaged(state: Path) -> list[str]:
    """Checkpoints that count and cannot be read, a sentence each."""
    found = []
    for path in sorted({path.parent for path in state.glob("**/checkpoint-*.safetensors")}):
        for step in checkpoints(path):
            try:
                load_checkpoint(path, step)
            except CheckpointError as error:
                found.append(str(error))
    return found


def unfinished(folder: Path) -> list[str]:
    """Files of a run that were being written when its process died."""
    paths = [*folder.glob("**/*.writing"), *folder.glob("**/.*")]
    return sorted(str(path.relative_to(folder)) for path in paths)


def rows_of(path: Path) -> list[dict[str, str]]:
    """A CSV file's rows without the clocks."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return [{key: text for key, text in row.items() if key not in CLOCKS} for row in rows]


def is_clear(errors: str) -> bool:
    """Whether a command that failed says why before all else.

    Below its sentence it may show the end of Flower's log, and that may hold a traceback; one of
    its own would stand above.
    """
    return errors.startswith("risfleet: ") and len(errors.splitlines()[0]) > len("risfleet: ")


def resumed_window(printed: str) -> int | None:
    """The window that a resume says it goes on from, None if it does not say."""
    found = re.search(r"going on from window (\d+)", printed)
    return int(found[1]) if found else None
