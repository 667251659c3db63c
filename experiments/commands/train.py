"""``risfleet train``: one run, or with ``-m`` one for each combination of values."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from rich.console import Console

from conf import ConfigError
from conf.commented import commented_yaml
from conf.overrides import parse
from conf.user_paths import pasted
from experiments.batch import train as batch
from experiments.batch.search import OBJECTIVE, search
from experiments.batch.sweeps import DIR, Sweep, planned_sweep, sweep_folder, train_in_turn
from experiments.console import PLAIN
from experiments.console.screen import Screen
from experiments.runtimes.runner import ERRORS, planned, print_error, train
from training import resume
from training.preflight import checked

FLAGS = ("-m", "--multirun", "--cfg")
SWEEPERS = "hydra.sweeper."
BASIC = "hydra/launcher=basic"


def main(arguments: Sequence[str]) -> int:
    """Runs the command; returns the exit status."""
    try:
        objective, arguments = _objective(arguments)
        flags = [item for item in arguments if item.startswith("-")]
        overrides = [item for item in arguments if not item.startswith("-")]
        _check_flags(flags, resumes=resume.asked(overrides))
        if "--cfg" in flags:
            print(commented_yaml(checked(overrides)), end="")
            return 0
        if flags:
            return _train_all(overrides, objective)
        if objective is not None:
            raise ConfigError(f"--objective {objective}: allowed with -m hydra/sweeper=NAME.")
        return train(*planned(overrides)).status
    except ERRORS as error:
        return print_error(error)


def _objective(arguments: Sequence[str]) -> tuple[str | None, list[str]]:
    """What stands behind ``--objective``, None without it, and the other arguments."""
    parser = argparse.ArgumentParser("risfleet train", add_help=False, allow_abbrev=False)
    parser.add_argument("--objective", metavar="MEASURE")
    given, rest = parser.parse_known_args(arguments)
    return given.objective, rest


def _check_flags(flags: Sequence[str], *, resumes: bool) -> None:
    """Checks that options are known and go together.

    Raises:
        ConfigError: they do not.
    """
    unknown = [flag for flag in flags if flag not in FLAGS]
    if unknown:
        raise ConfigError(f"{unknown[0]} is no option: there are -m and --cfg.")
    if "--cfg" in flags and (len(flags) > 1 or resumes):
        raise ConfigError("--cfg prints one configuration: allowed without -m and resume=RUN.")
    if flags and resumes:
        raise ConfigError("resume=RUN goes on with one run: allowed without -m.")


def _train_all(overrides: Sequence[str], objective: str | None = None) -> int:
    """Runs a sweep or a search, all of it checked before the first run starts; the exit status.

    Without a launcher runs follow one another in this process. In a folder that holds this sweep
    already, runs that have ended are left as they are, and those that have begun go on.
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
