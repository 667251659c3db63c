"""``risfleet train -m``: a run for each combination of values."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from rich.console import Console

from conf import ConfigError
from conf.overrides import parse
from conf.user_paths import pasted
from experiments.batch import train as batch
from experiments.batch.search import OBJECTIVE
from experiments.batch.sweeps import DIR, Sweep, planned_sweep, sweep_folder, train_in_turn
from experiments.commands.search import search
from experiments.console import PLAIN
from experiments.console.screen import Screen
from experiments.runtimes.runner import print_error

SWEEPERS = "hydra.sweeper."
BASIC = "hydra/launcher=basic"


def train_all(overrides: Sequence[str], objective: str | None = None) -> int:
    """Runs every combination of a sweep, all of them checked before the first one starts.

    Without a launcher they follow one another in this process. In a folder that holds this sweep
    already, runs that have ended are left as they are, and those that have begun go on.

    Args:
        overrides: some of them with several values.
        objective: what a sweeper of Hydra's is told of each run; None if it is not given.

    Returns:
        The exit status: 0, 1 where a run failed, or that of the signal that ended the runs early.
    """
    parsed = parse(overrides, sweep=True, launcher=True, sweeper=True)
    if any(item.key_or_group == "hydra/sweeper" for item in parsed):
        rest = [item for item in parsed if item.key_or_group != DIR]
        place = sweep_folder([item for item in parsed if item.key_or_group == DIR])
        return search(rest, place, objective or OBJECTIVE)
    if objective is not None or any(item.key_or_group.startswith(SWEEPERS) for item in parsed):
        say = "with hydra/sweeper=NAME, which chooses values by it"
        raise ConfigError(f"--objective and hydra.sweeper.KEY: allowed {say}.")
    with planned_sweep(overrides) as sweep:
        if sweep.launcher in ([], [BASIC]):
            return train_in_turn(sweep.configs, Screen(), print_error).status
        return _at_once(sweep)


def _at_once(sweep: Sweep) -> int:
    console = Console()
    console.print(f"sweep folder: {sweep.folder}", **PLAIN)
    outcome = batch.train(sweep.configs, sweep.folder, console, sweep.launcher)
    for run, why in outcome.failed.items():
        print(f"risfleet: {run} failed: {why}", file=sys.stderr)
    if outcome.signal:
        again = f"the same command with {pasted(DIR, sweep.folder)}"
        console.print(f"Stopped early by {outcome.signal}. To go on: {again}", **PLAIN)
    elif not outcome.status:
        console.print(f"all {len(outcome.done)} runs are there", highlight=False)
    return outcome.status
