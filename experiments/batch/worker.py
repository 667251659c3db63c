"""One run of many, in a process that a Hydra launcher started."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from conf import Config
from experiments.runtimes.runner import train_quietly
from experiments.runtimes.stopping import IgnoredSignals
from training.run_folder import RunFolder

LOOK_S = 1.0


@dataclass(frozen=True)
class Work:
    """What Hydra's launcher calls for every run, in whatever process.

    Attributes:
        configs: of all runs, with their folders; Hydra's number of a job is its place.
        stop: a file that keeps runs from beginning once it is there.
        owner: the process that shows progress and takes signals.
    """

    configs: tuple[Config, ...]
    stop: Path
    owner: int

    def __call__(self, node: DictConfig) -> None:
        """Trains what is missing of a run; its folder says what became of it.

        Its configuration was made and checked before, whatever Hydra has composed.
        """
        config = self.configs[int(HydraConfig.get().job.num)]
        folder = RunFolder.of(config)
        here = os.getpid() == self.owner
        with (
            nullcontext() if here else IgnoredSignals(),
            _ending_with(self.owner, [self.stop, folder.stop_file]),
        ):
            if self.stop.exists():
                return
            with suppress(Exception):  # its folder says why, if the run got so far
                train_quietly(config)


@contextmanager
def _ending_with(owner: int, stops: Sequence[Path]) -> Iterator[None]:
    """Ends runs at their next window, and then this process, if the one that owns it dies."""
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(LOOK_S):
            if os.getppid() != owner:
                for stop in stops:
                    with suppress(OSError):  # this process must end in any case
                        stop.touch()
                ended.wait()
                os._exit(1)  # else the launcher's process would wait for work for minutes

    watcher = threading.Thread(target=watch, name="owner", daemon=True)
    if os.getppid() == owner:  # not in the owner itself, nor on another machine
        watcher.start()
    try:
        yield
    finally:
        ended.set()
        if watcher.is_alive():
            watcher.join()
