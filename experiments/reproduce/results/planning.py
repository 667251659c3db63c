"""What planned trajectories reach on the held-out starts of runs, worked out once and kept."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import io
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import NamedTuple

from omegaconf import OmegaConf
from rich.console import Console
from rich.progress import track

from agent import single_threaded
from conf import Config, ConfigError, fingerprint
from env.config import RewardConfig, StateConfig
from experiments.analysis.optimality_gap import SLACK
from experiments.analysis.played import planned
from storage.atomic import write_atomically
from training.evaluation import Evaluator

SETTING = ("robots", "side", "max_dbm", "access", "share", "metric", "seed", "episodes", "slack")
"""Columns that say what a line is of."""


class Planned(NamedTuple):
    """Means over the held-out episodes of a run, each driven along its planned trajectories.

    Attributes:
        ee: energy efficiency in bit/s/Hz/J, the objective (5a).
        ee_bits_per_joule: all bits over all energy, in bit/J.
        sum_rate: in bit/s/Hz.
        min_rate: the least over robots of a robot's mean rate, in bit/s/Hz.
        path_ratio: slots driven over the fewest possible.
        gain_db: mean of |h_k|^2 in dB over robots and slots.
    """

    ee: float
    ee_bits_per_joule: float
    sum_rate: float
    min_rate: float
    path_ratio: float
    gain_db: float


COLUMNS = ("key", *SETTING, *Planned._fields)

Row = dict[str, str]
"""A line of the file, by ``COLUMNS``."""


def planned_values(configs: Sequence[Config], file: Path) -> list[Planned]:
    """What trajectories come to that are planned from the starts that the runs are evaluated on.

    With several robots a plan is a lower bound on the best (``env.oracles.trajectory``). What the
    file holds is not worked out again; each value is written as soon as it is there.

    Args:
        configs: of runs; the values have their order.
        file: a CSV file, made where it is missing.

    Raises:
        ConfigError: no plan can be made: channels change in each slot, or time is too short.
    """
    keys = [_key(config) for config in configs]
    kept = {_setting(row): row for row in _read(file)}
    known = {row["key"]: row for row in kept.values() if all(map(row.get, Planned._fields))}
    missing = {k: c for k, c in zip(keys, configs, strict=True) if k not in known}
    try:
        for row in _worked_out(missing):
            known[row["key"]] = kept[_setting(row)] = row
            _write(file, [kept[setting] for setting in sorted(kept)])
    except ValueError as error:
        raise ConfigError(f"{error}.") from error
    return [Planned(*(float(known[key][name]) for name in Planned._fields)) for key in keys]


def _key(config: Config) -> str:
    """What the values depend on: the environment, the starts, and this version of the program.

    What agents see and are paid is no part of it: a task is planned once for all who learn it.
    """
    task = dataclasses.replace(config.env, state=StateConfig(), reward=RewardConfig())
    env = OmegaConf.to_yaml(OmegaConf.structured(task))
    parts = fingerprint(task), env, config.seed, config.evaluation.episodes, SLACK
    return hashlib.sha256("\n".join(map(str, parts)).encode()).hexdigest()[:16]


def _worked_out(missing: dict[str, Config]) -> Iterator[Row]:
    """The rows of what is missing, as they come; an interrupt leaves the rest undone."""
    if not missing:
        return
    show, processes = Console(stderr=True), min(os.cpu_count() or 1, len(missing))
    if processes < 2:
        yield from map(_row, track(missing.values(), "planning trajectories", console=show))
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(processes, context, single_threaded)
    try:
        rows = as_completed([pool.submit(_row, config) for config in missing.values()])
        for done in track(rows, "planning trajectories", total=len(missing), console=show):
            yield done.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _row(config: Config) -> Row:
    drive = planned(Evaluator(config))
    env, found = config.env, drive.measures.summary()
    values = found | {
        "key": _key(config),
        "robots": env.robots,
        "side": env.ris.side,
        "max_dbm": env.power.max_dbm,
        "access": env.access,
        "share": env.oma.share if env.access == "oma" else "",
        "metric": env.metric,
        "seed": config.seed,
        "episodes": config.evaluation.episodes,
        "slack": SLACK,
        "gain_db": drive.gain_db,
    }
    return {name: str(values[name]) for name in COLUMNS}


def _setting(row: Row) -> tuple[str, ...]:
    """What a line is of, so that a new one takes the place of an earlier version's."""
    return tuple(row[name] for name in SETTING)


def _read(file: Path) -> list[Row]:
    if not file.exists():
        return []
    with file.open(encoding="utf-8-sig", newline="") as text:
        return list(csv.DictReader(text))


def _write(file: Path, rows: Sequence[Row]) -> None:
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(file, text.getvalue())
