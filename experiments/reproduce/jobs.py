"""Which runs are still to be trained, and how they are dealt to processes."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from conf import Config, fingerprint
from conf.schema import RunConfig
from experiments.evaluate import read_config, read_weights
from experiments.reproduce.plan import COMMON, Cell
from server_app import resume
from server_app.checkpoint import Checkpoint

TICKS_PER_EPISODE = 85
MS_PER_TICK_AND_ROBOT = 0.5
COST = {"federated": 1.0, "branching": 0.65, "centralized": 4.0}
"""Processor time of a tick against F-DRL's (docs/baselines.md): which jobs are long, no more."""


class State(Enum):
    """What a run's folder holds."""

    DONE = "done"
    BEGUN = "begun"  # a checkpoint, from which it goes on
    NEW = "new"  # nothing, or nothing that can be used


@dataclass(frozen=True)
class Job:
    """Some seeds of one cell, to be trained by one process.

    Attributes:
        overrides: Hydra's, without the seed.
        configs: checked, with ``run.dir``; they differ in seed and folder alone.
    """

    overrides: tuple[str, ...]
    configs: tuple[Config, ...]

    @property
    def folders(self) -> tuple[Path, ...]:
        """Of the runs."""
        return tuple(folder_of(config) for config in self.configs)

    @property
    def cost_s(self) -> float:
        """A rough guess of its processor time."""
        return sum(map(cost_s, self.configs))


def folder_of(config: Config) -> Path:
    """A run's folder."""
    return Path(str(config.run.dir))


def cost_s(config: Config) -> float:
    """A rough guess of a run's processor time in s."""
    ticks = config.train.episodes * TICKS_PER_EPISODE
    ticks = min(ticks, config.train.max_ticks or ticks)
    each_ms = MS_PER_TICK_AND_ROBOT * config.env.robots * COST[config.scheme.agents]
    return ticks * each_ms / 1000


def state_of(config: Config) -> State:
    """What the folder of a run holds."""
    if _is_done(config):
        return State.DONE
    try:
        found = resume.standing(config, folder_of(config))
    except (LookupError, OSError, ValueError):
        return State.NEW
    return State.BEGUN if isinstance(found, Checkpoint) else State.NEW


def _is_done(config: Config) -> bool:
    """Whether a run has ended as it was meant to, and its files can be read."""
    folder = folder_of(config)
    try:
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8-sig"))
        whole = not summary["stopped_early"] and summary["fingerprint"] == fingerprint(config.env)
        if not whole or not _same(read_config(folder), config):
            return False
        read_weights(folder, config)
    except (LookupError, TypeError, ValueError, OSError):
        return False
    return all((folder / name).is_file() for name in ("metrics.csv", "evaluations.csv"))


def _same(one: Config, other: Config) -> bool:
    """Whether two configurations are of one run, wherever its folder lies."""
    nowhere = RunConfig()
    return dataclasses.replace(one, run=nowhere) == dataclasses.replace(other, run=nowhere)


def missing(
    cells: Sequence[tuple[Cell, Mapping[int, Config]]], states: Mapping[Path, State]
) -> list[Job]:
    """Jobs for what is not done, a job a cell where its seeds may be trained together.

    Args:
        cells: each with its runs' configurations, by seed; two cells may share runs.
        states: of every run's folder.
    """
    jobs: list[Job] = []
    taken: set[Path] = set()
    for cell, runs in cells:
        left = [c for c in runs.values() if folder_of(c) not in taken]
        taken |= {folder_of(config) for config in left}
        overrides = (*COMMON, *cell.overrides)
        begun = [c for c in left if states[folder_of(c)] is State.BEGUN]
        new = [c for c in left if states[folder_of(c)] is State.NEW]
        if cell.alone:
            begun, new = begun + new, []
        jobs += [Job(overrides, (config,)) for config in begun]
        if new:
            jobs.append(Job(overrides, tuple(new)))
    return jobs


def dealt(jobs: Sequence[Job], workers: int) -> list[Job]:
    """Jobs, the longest first; one that would hold up the end is split by seeds.

    Args:
        jobs: what is to be trained.
        workers: how many processes train at once.
    """
    found = list(jobs)
    fair_s = sum(job.cost_s for job in jobs) / workers
    while divisible := [job for job in found if len(job.configs) > 1]:
        largest = max(divisible, key=lambda job: job.cost_s)
        if len(found) >= workers and largest.cost_s <= fair_s:
            break
        found.remove(largest)
        half = (len(largest.configs) + 1) // 2
        for part in (largest.configs[:half], largest.configs[half:]):
            found.append(dataclasses.replace(largest, configs=part))
    return sorted(found, key=lambda job: -job.cost_s)
