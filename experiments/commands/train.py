"""``risfleet train``: one run, or with ``-m`` one for each combination of values."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from conf import ConfigError
from conf.commented import commented_yaml
from experiments.commands.sweep import train_all
from experiments.runtimes.runner import ERRORS, planned, print_error, train
from training import resume
from training.preflight import checked

FLAGS = ("-m", "--multirun", "--cfg")


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
            return train_all(overrides, objective)
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
