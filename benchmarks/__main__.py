"""Runs the benchmarks, prints one table and writes ``bench.json``.

python -m benchmarks [--quick] [--only NAME ...] [--json FILE]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path

from rich.console import Console

from benchmarks.report import as_json, table
from benchmarks.result import Result, Skipped

BENCHMARKS = {
    "engine": "engine_vs_four_learners_",
    "env_step": "world_",
    "parts": "part_",
    "scaling": "steps_per_s_ updates_vs_",
    "rooms": "robot_in_rooms_ room_mb rooms_abreast_",
    "central": "centralized_ branching_",
    "deployment": "link_share lockstep_efficiency lockstep_cpu_vs_free waiting_share",
    "lockstep": "lockstep_bound_ lockstep_of_bound_",
    "runs": "rate_ simulation_ deployment_ flower_share evaluation_share weights_vs_",
    "memory": "memory_ busy_",
    "overheads": "checkpoint_ tls_",
    "distance": "distance_",
}
"""Each benchmark, a module with a function of its name, and how its results' names begin."""

TABLE_WIDTH = 100


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status: 0, or 1 where a benchmark failed."""
    given = _parser().parse_args(arguments)
    console = Console()
    console.width = max(console.width, TABLE_WIDTH)
    results: list[Result] = []
    failed: dict[str, str] = {}
    for name in _chosen(given.only):
        began = time.perf_counter()
        console.print(f"{name} ...", end=" ", highlight=False)
        try:
            results += _benchmark(name)(quick=given.quick)
        except Skipped as reason:
            console.print(f"skipped: {reason}", highlight=False, markup=False)
        except Exception as error:
            failed[name] = f"{type(error).__name__}: {error}"
            console.print(f"failed: {failed[name]}", highlight=False, markup=False)
        else:
            console.print(f"{time.perf_counter() - began:.0f} s", highlight=False)
    console.print(table(results))
    given.json.write_text(as_json(results, failed, quick=given.quick), encoding="utf-8")
    console.print(f"written to {given.json}", highlight=False, soft_wrap=True)
    return 1 if failed else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("python -m benchmarks", description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="short blocks: does it run?")
    names = f"benchmarks ({', '.join(BENCHMARKS)}) or names of results"
    parser.add_argument("--only", nargs="+", metavar="NAME", type=known, help=names)
    parser.add_argument("--json", type=Path, default=Path("bench.json"), metavar="FILE")
    return parser


def known(name: str) -> str:
    """The benchmark of this name, or the one that finds the result of this name."""
    for benchmark, beginnings in BENCHMARKS.items():
        if name == benchmark or name.startswith(tuple(beginnings.split())):
            return benchmark
    raise argparse.ArgumentTypeError(f"{name!r}: allowed is one of {', '.join(BENCHMARKS)}")


def _chosen(only: Sequence[str] | None) -> list[str]:
    return [name for name in BENCHMARKS if only is None or name in only]


def _benchmark(name: str) -> Callable[..., list[Result]]:
    function: Callable[..., list[Result]] = getattr(import_module(f"benchmarks.{name}"), name)
    return function


if __name__ == "__main__":
    sys.exit(main())
