"""``risfleet status RUN``: where a run is."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from experiments.display import describe, read_progress, silent_s

SILENT_S = 10.0
"""A run that writes nothing for longer may have died."""


def main(arguments: Sequence[str]) -> int:
    """Runs the command; returns the exit status."""
    if len(arguments) != 1:
        print("risfleet: status needs one run folder: risfleet status RUN", file=sys.stderr)
        return 2
    folder = Path(arguments[0])
    status = read_progress(folder)
    if status is None:
        print(f"risfleet: {folder} holds no run that has begun", file=sys.stderr)
        return 2
    table = Table.grid(padding=(0, 2))
    for name, text in describe(status):
        table.add_row(name or "state", text)
    if status["message"]:
        table.add_row("message", Text(str(status["message"])))
    silence = silent_s(status)
    if silence is not None and silence > SILENT_S:
        table.add_row("last heard", f"{silence:.0f} s ago")
    Console().print(table)
    return 0
