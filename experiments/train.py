"""``risfleet train``: one run, or with ``-m`` one for each combination of values."""

from __future__ import annotations

import dataclasses
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from hydra import main as hydra_main
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig
from rich.console import Console

from agent import checkpoints
from conf import Config, ConfigError, from_composed, register_schema, to_yaml
from conf.compose import FOLDER, check_overrides
from conf.places import STATE, server_folder
from env.link import LinkError
from env.plugins import PluginError
from experiments import local, on_flower
from experiments.display import Display, show_summary
from experiments.flower import FlowerError
from experiments.folders import alone, check_unused, new_folder
from server_app import resume
from server_app.checkpoint import Checkpoint
from server_app.preflight import check, check_address, checked, checked_training
from server_app.session import STOP_FILE

INTERRUPTED = 130
ERRORS = (ConfigError, PluginError, FlowerError, LinkError, OSError)
"""What ends a run with a sentence: a mistake, or a machine, disk or network that fails."""

Runtime = Callable[[Config, Path, Checkpoint | None], dict[str, Any]]
RUNTIMES: dict[str, Runtime] = {
    "local": local.train,
    "simulation": on_flower.train,
    "deployment": on_flower.train,
}


def main(arguments: Sequence[str]) -> int:
    """Runs the command; returns the exit status."""
    flags = [item for item in arguments if item.startswith("-")]
    overrides = [item for item in arguments if not item.startswith("-")]
    unknown = [flag for flag in flags if flag not in ("-m", "--multirun", "--cfg")]
    try:
        if unknown:
            raise ConfigError(f"{unknown[0]} is no option: there are -m and --cfg.")
        if "--cfg" in flags and (len(flags) > 1 or resume.asked(overrides)):
            raise ConfigError("--cfg prints one configuration: allowed without -m and resume=RUN.")
        if "--cfg" in flags:
            print(to_yaml(checked(overrides)), end="")
            return 0
        if flags and resume.asked(overrides):
            raise ConfigError("resume=RUN goes on with one run: allowed without -m.")
        if flags:
            return _train_all(overrides)
        if resume.asked(overrides):
            config, checkpoint = resume.read(overrides)
            _check_address(config)
            return train(config, Path(str(config.run.dir)), checkpoint)
        config = checked_training(overrides)
        _check_address(config)
        return train(config, new_folder(config))
    except ERRORS as error:
        _say(error)
        return 2 if isinstance(error, ConfigError | PluginError) else 1


def train(config: Config, folder: Path, resumed: Checkpoint | None = None) -> int:
    """Trains one run and shows it.

    Args:
        config: a checked configuration.
        folder: the run's folder, new or empty unless it goes on.
        resumed: where the run goes on, if it does not begin.

    Returns:
        0, or 130 if Ctrl-C ended the run early.
    """
    console = Console()
    folder = folder.absolute()
    run = dataclasses.replace(config.run, dir=str(folder), id=config.run.id or resume.new_id())
    config = dataclasses.replace(config, run=run)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        allowed = f"a folder that can be made ({error.strerror})"
        raise ConfigError.of([("run.dir", folder, allowed)]) from error
    console.print(f"run folder: {folder}", highlight=False, soft_wrap=True)
    with alone(folder):
        if resumed is not None:
            for reason in resumed.passed_over:
                console.print(f"passed over: {reason}", highlight=False, soft_wrap=True)
            console.print(f"going on from window {resumed.window}", highlight=False)
            for stale in ("progress.json", "summary.json"):
                (folder / stale).unlink(missing_ok=True)
        with StopOnInterrupt(folder, console) as stop, Display(folder, console):
            try:
                summary = RUNTIMES[config.runtime.name](config, folder, resumed)
            except ERRORS as error:
                if checkpoints(server_folder(folder / STATE)):
                    error.add_note(f"To go on: risfleet train {resume.PREFIX}{folder}")
                raise
    if summary:
        show_summary(console, summary, folder)
    else:
        console.print("The run has ended; its folder is on the machine of the ServerApp.")
    if stop.asked:
        console.print("Stopped early by Ctrl-C: what was learned until then is in the run folder.")
    return INTERRUPTED if stop.asked else 0


def _say(error: BaseException) -> None:
    """Prints what went wrong, and how to go on where that is known."""
    print(f"risfleet: {error}", *getattr(error, "__notes__", []), sep="\n", file=sys.stderr)


def _check_address(config: Config) -> None:
    """Checks the link's address, unless it is another machine's."""
    if config.runtime.connection is None:
        check_address(config)


class StopOnInterrupt:
    """Ctrl-C asks a run to end at its next aggregation; a second one ends it at once.

    Args:
        folder: the run's folder.
        console: where to say so.
    """

    def __init__(self, folder: Path, console: Console) -> None:
        self._file, self._console = folder / STOP_FILE, console
        self.asked = False

    def __enter__(self) -> StopOnInterrupt:
        """Takes Ctrl-C over."""
        self._file.unlink(missing_ok=True)  # of a run that was killed
        self._before = signal.signal(signal.SIGINT, self._on_interrupt)
        return self

    def __exit__(self, *error: object) -> None:
        """Gives Ctrl-C back."""
        signal.signal(signal.SIGINT, self._before)
        self._file.unlink(missing_ok=True)

    def _on_interrupt(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
        self._file.touch()
        self._console.print("Stopping at the next aggregation; Ctrl-C again stops at once.")


def _train_all(overrides: Sequence[str]) -> int:
    """Runs every combination of a sweep, all of them checked before the first one starts."""
    check_overrides(overrides, sweep=True)
    hydra_keys = [item for item in overrides if item.startswith("hydra")]
    for combination in _combinations(overrides):
        checked_training([*combination, *hydra_keys])
    folder = next(
        (item.split("=", 1)[1] for item in overrides if item.startswith("run.dir=")), None
    )
    if folder is not None:
        check_unused(Path(folder))
    statuses: list[int] = []

    def job(node: DictConfig) -> None:
        statuses.append(_job(node))

    register_schema()
    rest = [item for item in overrides if not item.startswith("run.dir=")]
    before, sys.argv = (
        sys.argv,
        [
            "risfleet",
            "--multirun",
            *rest,
            f"hydra.sweep.dir={folder or time.strftime('multirun/%Y-%m-%d_%H-%M-%S')}",
            "hydra.sweep.subdir=${hydra.job.num}",
            "hydra.output_subdir=null",
            "hydra/job_logging=none",
        ],
    )
    try:
        hydra_main(config_path=str(FOLDER), config_name="config", version_base="1.3")(job)()
    finally:
        sys.argv = before
    return max(statuses, default=0)


def _combinations(overrides: Sequence[str]) -> list[list[str]]:
    ours = [item for item in overrides if not item.startswith("hydra")]
    try:
        parsed = OverridesParser.create().parse_overrides(ours)
        batches = BasicSweeper.split_arguments(parsed, max_batch_size=None)
    except HydraException as error:
        raise ConfigError(str(error).splitlines()[0]) from error
    return [list(combination) for batch in batches for combination in batch]


def _job(node: DictConfig) -> int:
    """One run of a sweep; one that fails says why and leaves the others to go on."""
    config = check(from_composed(node, HydraConfig.get().overrides.task))
    try:
        status = train(config, Path(HydraConfig.get().runtime.output_dir))
    except ERRORS as error:
        _say(error)
        return 1
    if status == INTERRUPTED:
        raise KeyboardInterrupt
    return status
