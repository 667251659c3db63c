"""``risfleet status RUN``: where a run is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from conf import ConfigError
from conf.user_paths import user_path
from experiments.console.display import SILENT_S, describe, silent_s
from training.run_folder import RunFolder


def _federation(status: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Checkpoint, Flower round, rooms and clients, as far as the run has them."""
    if status.get("checkpoint") is not None:
        yield "last checkpoint", f"window {status['checkpoint']} of {status['window']}"
    if status.get("round"):
        yield "round", str(status["round"])
    if (rooms := status.get("rooms")) is not None:
        missing = ", ".join(map(str, rooms["missing"]))
        said = f"{rooms['took_part']} of {rooms['count']} took part in the last round"
        yield "rooms", f"{said}, missing: {missing}" if missing else said
    for client in status.get("clients", ()):
        there = "connected" if client["connected"] else "not connected"
        if "rooms" in client:
            first, last = client["rooms"][0], client["rooms"][-1]
            name = f"room {first}" if first == last else f"rooms {first} to {last}"
            missed = f", missed the last round: {client['missed']}" if client.get("missed") else ""
            yield name, f"{there}, {client['flower_bytes'] / 1e6:.1f} MB in messages{missed}"
            continue
        robots = ", ".join(map(str, client["robots"]))
        sent = client["bytes_sent"] + client["bytes_received"]
        yield f"robot {robots}", f"{there}, {sent / 1e6:.1f} MB on the link"


def main(arguments: Sequence[str]) -> int:
    """Runs the command; returns the exit status."""
    if len(arguments) != 1:
        raise ConfigError("status needs one run folder: risfleet status RUN")
    folder = RunFolder(user_path(arguments[0]))
    status = folder.read_progress()
    if status is None:
        raise ConfigError(f"{folder} holds no run that has begun")
    table = Table.grid(padding=(0, 2))
    for name, text in (*describe(status), *_federation(status)):
        table.add_row(name or "state", text)
    if status["message"]:
        table.add_row("message", Text(str(status["message"])))
    silence = silent_s(status)
    if silence is not None and silence > SILENT_S:
        table.add_row("last heard", f"{silence:.0f} s ago")
    Console().print(table)
    return 0
