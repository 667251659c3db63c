"""``risfleet train -m``: a run for each combination of values, seeds together where asked for."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from hydra import main as hydra_main
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig

from conf import Config, ConfigError, from_composed, register_schema
from conf.compose import FOLDER, check_overrides
from experiments.folders import check_unused, dated
from experiments.runner import ERRORS, INTERRUPTED, say, train, train_together
from experiments.together import check_local
from server_app.preflight import check, checked_training

Combination = list[str]
SEED = "seed="
PLACES = ("hydra.sweep.dir", "hydra.sweep.subdir", "hydra.run.dir")


def train_all(overrides: Sequence[str], *, together: bool = False) -> int:
    """Runs every combination of a sweep, all of them checked before the first one starts.

    Args:
        overrides: some of them with several values.
        together: whether runs that differ in nothing but their seed are trained side by side.

    Returns:
        The exit status.
    """
    check_overrides(overrides, sweep=True)
    hydra_keys = [item for item in overrides if item.lstrip("+").startswith("hydra")]
    for item in hydra_keys:
        if item.split("=")[0].lstrip("+") in PLACES:
            raise ConfigError(f"{item}: allowed is run.dir=FOLDER, which a sweep's runs lie in.")
    every = _combinations([item for item in overrides if item not in hydra_keys])
    configs = [checked_training([*combination, *hydra_keys]) for combination in every]
    if together:
        for config in configs:
            check_local(config)
    folder = next(
        (item.split("=", 1)[1] for item in overrides if item.startswith("run.dir=")), None
    )
    if folder is not None:
        check_unused(Path(folder))
    place = folder or str(dated(Path("multirun")))
    rest = [item for item in overrides if not item.startswith("run.dir=")]
    if not together:
        return _sweep(
            rest, place, "${hydra.job.num}", lambda config, folder, _: train(config, folder)
        )
    groups = _groups(every)
    seeds = [config.seed for config in configs]

    def train_group(config: Config, folder: Path, number: int) -> int:
        jobs = groups[number]
        runs = [(dataclasses.replace(config, seed=seeds[job]), folder / str(job)) for job in jobs]
        return train_together(runs)

    firsts = [item if not item.startswith(SEED) else f"{SEED}{seeds[0]}" for item in rest]
    return _sweep(firsts, place, ".", train_group)


def _groups(every: Sequence[Combination]) -> list[list[int]]:
    """The jobs of a sweep, by number, in groups that differ in nothing but their seed."""
    found: dict[tuple[str, ...], list[int]] = {}
    for number, combination in enumerate(every):
        rest = tuple(item for item in combination if not item.startswith(SEED))
        found.setdefault(rest, []).append(number)
    return list(found.values())


def _sweep(
    overrides: Sequence[str], place: str, subfolder: str, job: Callable[[Config, Path, int], int]
) -> int:
    """Lets Hydra call a job for every combination, with its folder and its number.

    Args:
        overrides: of the sweep.
        place: its folder.
        subfolder: a job's folder in it.
        job: returns an exit status.

    Returns:
        The largest of them.
    """
    statuses: list[int] = []

    def run(node: DictConfig) -> None:
        hydra = HydraConfig.get()
        config = check(from_composed(node, hydra.overrides.task))
        try:
            status = job(config, Path(hydra.runtime.output_dir), int(hydra.job.num))
        except ERRORS as error:  # what fails leaves the others to go on
            say(error)
            status = 1
        if status == INTERRUPTED:
            raise KeyboardInterrupt
        statuses.append(status)

    register_schema()
    before, sys.argv = (
        sys.argv,
        [
            "risfleet",
            "--multirun",
            *overrides,
            f"hydra.sweep.dir={place}",
            f"hydra.sweep.subdir={subfolder}",
            "hydra.output_subdir=null",
            "hydra/job_logging=none",
        ],
    )
    try:
        hydra_main(config_path=str(FOLDER), config_name="config", version_base="1.3")(run)()
    finally:
        sys.argv = before
    return max(statuses, default=0)


def _combinations(overrides: Sequence[str]) -> list[Combination]:
    """Every combination of a run's overrides, Hydra's own keys left out."""
    try:
        parsed = OverridesParser.create().parse_overrides(list(overrides))
        batches = BasicSweeper.split_arguments(parsed, max_batch_size=None)
    except HydraException as error:
        raise ConfigError(str(error).splitlines()[0]) from error
    return [list(combination) for batch in batches for combination in batch]
