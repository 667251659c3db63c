"""``risfleet reproduce``: trains what a figure or table needs, and makes it."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from rich.console import Console

from conf import ConfigError
from conf.overrides import is_hydras, lines, parse
from conf.user_paths import user_path
from experiments.batch.launcher import DEFAULT
from experiments.batch.train import BatchOutcome
from experiments.console import PLAIN
from experiments.console.arguments import positive
from experiments.reproduce.results.runs import Runs
from experiments.reproduce.runner import Plan, train
from experiments.reproduce.targets import manifest
from experiments.reproduce.targets.plan import TARGETS, Cell, Target, with_overrides

ALL = "all"
OWN = ("seed", "runtime", "run", "resume")
"""Keys that a target sets itself."""

EPILOG = """\
KEY=VALUE is set in every run, on top of what a target sets; hydra/launcher=NAME picks another of
Hydra's launchers. Runs that are done are kept, also between targets; one that was stopped goes on.

examples:
  risfleet reproduce fig3 --quick
  risfleet reproduce all --out results-mine
  risfleet reproduce ablations --jobs 1 env.map_seed=1"""


def main(arguments: Sequence[str]) -> int:
    """Runs the command; returns the exit status."""
    given = _parser().parse_intermixed_args(arguments)
    began = time.perf_counter()
    console = Console()
    out = given.out or Path("reproduce-quick" if given.quick else "reproduce")
    ours, hydra = _overrides(given.overrides)
    launchers = {item for item in hydra if item.startswith("hydra/launcher=")}
    if given.jobs and launchers - {DEFAULT}:
        raise ConfigError(f"--jobs {given.jobs}: allowed with Hydra's launcher joblib alone.")
    targets = _targets(given.target)
    cells = {t.name: with_overrides(t.cells(given.quick), ours) for t in targets}
    plan = Plan([cell for each in cells.values() for cell in each], out)
    if status := _said(train(plan, given.jobs, hydra, console), console):
        return status
    call = {"quick": given.quick, "overrides": ours}
    for target in targets:
        runs = plan.runs(cells[target.name])
        _report(target, cells[target.name], runs, out, call, began, console)
    return 0


def _report(
    target: Target,
    cells: Sequence[Cell],
    runs: Runs,
    out: Path,
    call: dict[str, Any],
    began: float,
    console: Console,
) -> None:
    """Makes what a target makes of its runs, with a manifest, and shows tables and file names."""
    console.print(f"{target.name}:")
    files = target.report(runs, out, quick=call["quick"])
    spent = {"wall_s": round(time.perf_counter() - began, 1)}
    files.append(manifest.write(out, target.name, cells, runs, files, call | spent))
    for path in files:
        if path.suffix == ".md":
            console.print(path.read_text(encoding="utf-8-sig"), **PLAIN)
    for path in files:
        console.print(f"  {path}", **PLAIN)


def _said(outcome: BatchOutcome, console: Console) -> int:
    """Says what is missing; returns the exit status: 0 if nothing is."""
    if outcome.signal:
        console.print(f"Stopped by {outcome.signal}: the same call goes on where the runs are.")
    for folder, why in outcome.failed.items():
        print(f"risfleet: {folder} failed: {why}", file=sys.stderr)
    if outcome.failed:
        print(
            f"risfleet: {len(outcome.failed)} runs failed, {len(outcome.done)} are there; nothing"
            " is drawn before all are: the same call tries those that failed again.",
            file=sys.stderr,
        )
    return outcome.status


def _targets(name: str) -> list[Target]:
    if name not in (*TARGETS, ALL):
        raise ConfigError(f"{name!r} is no target: allowed is one of {', '.join((*TARGETS, ALL))}.")
    names = TARGETS if name == ALL else (name,)
    return [import_module(f"experiments.reproduce.targets.{each}").TARGET for each in names]


def _overrides(given: Sequence[str]) -> tuple[list[str], list[str]]:
    """The runs' overrides, none of them of a key that the target sets, and Hydra's own."""
    found = parse(given, launcher=True)
    ours = [item for item in found if not is_hydras(item)]
    for item in ours:
        if item.key_or_group.split(".")[0] in OWN:
            say = f"{item.key_or_group} is the target's own: allowed are keys of a run"
            raise ConfigError(f"{item.input_line}: {say}.")
    return lines(ours), lines([item for item in found if is_hydras(item)])


def _parser() -> Any:
    parser = argparse.ArgumentParser(
        "risfleet reproduce",
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("target", metavar="TARGET", help=f"{', '.join(TARGETS)}, or {ALL}")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="a key of every run")
    say = "minutes on two cores: fewer seeds, shorter runs"
    parser.add_argument("--quick", action="store_true", help=say)
    say = "default: reproduce, or reproduce-quick"
    parser.add_argument("--out", type=user_path, metavar="DIR", help=say)
    parser.add_argument("--jobs", type=positive, metavar="N", help="processes; default: cores")
    return parser
