"""What became of the kills, as files and as a table."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path

from rich.table import Table

from tools.chaos.scenario import Row

CSV_NAME, JSON_NAME = "chaos.csv", "chaos.json"


def counts(rows: Sequence[Row]) -> dict[tuple[str, str], tuple[int, int]]:
    """Survived and tried, by runtime and role."""
    found: dict[tuple[str, str], tuple[int, int]] = {}
    for row in rows:
        survived, tried = found.get((row.runtime, row.role), (0, 0))
        found[row.runtime, row.role] = (survived + row.survived, tried + 1)
    return found


def write(folder: Path, rows: Sequence[Row], seed: int, skipped: Sequence[str]) -> None:
    """Writes ``chaos.csv``, a row a kill, and ``chaos.json``."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / CSV_NAME).open("w", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Row)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    content = {
        "seed": seed,
        "survived": sum(row.survived for row in rows),
        "tried": len(rows),
        "skipped": list(skipped),
        "kills": [asdict(row) for row in rows],
    }
    (folder / JSON_NAME).write_text(json.dumps(content, indent=2) + "\n")


def table(rows: Sequence[Row]) -> Table:
    """Survived of tried by runtime and role, and the longest wait of each."""
    shown = Table(title="Kills survived / tried")
    for name in ("runtime", "killed", "survived / tried", "slowest, s"):
        shown.add_column(name)
    for (runtime, role), (survived, tried) in sorted(counts(rows).items()):
        slowest = max(row.seconds for row in rows if (row.runtime, row.role) == (runtime, role))
        shown.add_row(runtime, role, f"{survived} / {tried}", f"{slowest:.1f}")
    shown.add_section()
    shown.add_row("all", "", f"{sum(row.survived for row in rows)} / {len(rows)}", "")
    return shown
