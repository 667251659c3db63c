"""A small task for the tests of ``risfleet train``, and ways to start the command and wait."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

SMALL = (
    "runtime=local",
    "env.robots=2",
    "env.room.cell_m=3",
    "env.motion.max_slots=8",
    "agent.learn_from=4",
    "agent.batch_size=4",
    "train.max_ticks=20",
    "federation.every=10",
    "evaluation.episodes=2",
    "run.figures=false",
    "run.tensorboard=false",
)
ENDLESS = (*(item for item in SMALL if not item.startswith("train")), "train.episodes=100000000")
PATIENCE_S = 300.0

Start = Callable[..., subprocess.Popen[str]]


def summary(folder: Path) -> dict[str, Any]:
    """What a run has written at its end."""
    content: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return content


def starter() -> Iterator[Start]:
    """Starts the command in a process of its own; those that remain are killed."""
    started: list[subprocess.Popen[str]] = []

    def run(*arguments: str, **options: Any) -> subprocess.Popen[str]:
        root = str(Path(__file__).parents[2])
        process = subprocess.Popen(
            [sys.executable, "-m", "experiments.cli", "train", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1", "PYTHONPATH": root},
            **options,
        )
        started.append(process)
        return process

    yield run
    for process in started:
        process.kill()
        process.communicate()


def wait_for(process: subprocess.Popen[str], condition: Callable[[], bool]) -> None:
    """Waits until something is so, as long as the process lives."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.05)


def is_training(folder: Path) -> bool:
    """Whether a run says so."""
    try:
        return bool(json.loads((folder / "progress.json").read_text())["state"] == "training")
    except (OSError, ValueError):
        return False


start = pytest.fixture(starter)
