"""One job of ``risfleet reproduce``, in a process that a Hydra launcher started."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from conf import Config
from experiments import together
from experiments.reproduce.jobs import Job
from server_app.files import report_failure
from server_app.session import STOP_FILE

LOOK_S = 1.0


def train_seeds(configs: Sequence[Config], folders: Sequence[Path]) -> None:
    """Trains runs that differ in their seeds alone, side by side where they can share a stack.

    One that has begun goes on; one that fails leaves the others to go on.

    Args:
        configs: of the runs.
        folders: theirs; each says in ``progress.json`` what became of its run.
    """
    runs = list(zip(configs, folders, strict=True))
    shared = all(map(together.can_share, configs))
    for batch in [runs] if shared else [[run] for run in runs]:
        if asked_to_stop(batch[0][1]):
            return
        endings = together.train(*zip(*batch, strict=True), missing=True)
        for ending, (_, folder) in zip(endings, batch, strict=True):
            if isinstance(ending, Exception):
                report_failure(folder, ending)


def asked_to_stop(folder: Path) -> bool:
    """Whether a run is not to begin any more: the store of all runs says so."""
    return (folder.parent.parent / STOP_FILE).exists()


@dataclass(frozen=True)
class Work:
    """What Hydra's launcher calls for every job, in whatever process.

    Attributes:
        jobs: all of them; Hydra's number of a job is its place.
        owner: the process that shows progress and takes Ctrl-C.
    """

    jobs: tuple[Job, ...]
    owner: int

    def __call__(self, node: DictConfig) -> None:
        """Trains what is missing of a job; what became of it is in the runs' folders.

        Args:
            node: as Hydra composed it; the job's configurations are the same, checked before.
        """
        job = self.jobs[int(HydraConfig.get().job.num)]
        with _ending_with(self.owner, job.folders):
            train_seeds(job.configs, job.folders)


@contextmanager
def _ending_with(owner: int, folders: Sequence[Path]) -> Iterator[None]:
    """Ends runs at their next window, and then this process, if the one that owns it dies."""
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(LOOK_S):
            if os.getppid() != owner:
                for folder in (folders[0].parent.parent, *folders):
                    with suppress(OSError):  # this process must end in any case
                        (folder / STOP_FILE).touch()
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
