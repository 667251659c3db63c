"""The table and ``bench.json``."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from rich.table import Table

from benchmarks.result import Result
from conf import version


def table(results: Sequence[Result]) -> Table:
    """All results, a row each, the target beside the value."""
    shown = Table(title="Benchmarks: median and range over blocks", title_justify="left")
    shown.add_column("result", no_wrap=True)
    for name in ("value", "range", "unit", "target"):
        shown.add_column(name, justify="right", no_wrap=True)
    for result in results:
        spread = f"{number(result.low)} - {number(result.high)}"
        target = "" if result.target is None else f"{result.target}{_verdict(result)}"
        shown.add_row(result.name, number(result.value), spread, result.unit, target)
    return shown


def _verdict(result: Result) -> str:
    assert result.target is not None
    return "" if result.target.met(result.value) else " [red]missed[/red]"


def number(value: float) -> str:
    """A number with three figures or so."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def as_json(results: Sequence[Result], failed: Mapping[str, str], *, quick: bool) -> str:
    """The values by name, then everything else about them under names of their own."""
    content: dict[str, Any] = {result.name: result.value for result in results}
    content["results"] = [
        {
            **asdict(result),
            "target": None if result.target is None else str(result.target),
            "target_met": None if result.target is None else result.target.met(result.value),
        }
        for result in results
    ]
    content["failed"] = dict(failed)
    content["quick"] = quick
    content["machine"] = {
        "cores": os.cpu_count(),
        "processor": platform.machine(),
        "python": platform.python_version(),
        **{name: version(name) for name in ("risfleet", "torch", "numpy", "flwr")},
    }
    return json.dumps(content, indent=2) + "\n"
