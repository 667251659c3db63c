"""Whole runs by the command line: Flower's simulation against the local runtime."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.result import Result, Target

FLOWER = Target(0.10, at_least=False)
TIMEOUT_S = 600.0
GRACE_S = 30.0
SEED = 0
SIMULATION_HOW = (
    "steps per second of runtime=simulation over runtime=local, same seed, {} ticks,"
    " start-up left out; simulation between two local runs"
)
FLOWER_HOW = "wall time in which joint steps stand still for Flower, after start-up; same run"
CPU_HOW = "processor time of the same runs, all processes, simulation over local"
EVALUATION_HOW = "wall time of evaluations over that of training, local runs of {} ticks"


class RunError(RuntimeError):
    """A run failed; the message holds the end of what it printed."""


def runs(*, quick: bool = False) -> list[Result]:
    """Measures ``simulation_vs_local``, ``flower_share``, ``evaluation_share`` and the like."""
    ticks = 1000 if quick else 5000
    with tempfile.TemporaryDirectory(prefix="risfleet-bench-") as folder:
        local = [_train("local", ticks, Path(folder) / "first")]
        simulation = _train("simulation", ticks, Path(folder) / "simulation")
        local.append(_train("local", ticks, Path(folder) / "second"))
    local_speed = np.array([run["steps_per_s"] for run in local])
    speed = simulation["steps_per_s"]
    share = np.array([run["evaluation_s"] / run["training_s"] for run in local])
    details = {
        "local_steps_per_s": float(local_speed.mean()),
        "simulation_steps_per_s": float(speed),
        "simulation_startup_s": float(simulation["startup_s"]),
        "simulation_waiting_share": float(simulation["waited_s"] / simulation["training_s"]),
        "same_weights": float(simulation["digest"] == local[0]["digest"] == local[1]["digest"]),
    }
    cpu = np.array([simulation["cpu_s"] / run["cpu_s"] for run in local])
    how = SIMULATION_HOW.format(simulation["ticks"])
    flower = np.array([simulation["flower_share"]])
    return [
        Result.over("simulation_vs_local", speed / local_speed, "ratio", how, None, details),
        Result.over("simulation_cpu_vs_local", cpu, "ratio", CPU_HOW),
        Result.over("flower_share", flower, "share", FLOWER_HOW, FLOWER),
        Result.over("evaluation_share", share, "share", EVALUATION_HOW.format(local[0]["ticks"])),
    ]


def _train(runtime: str, ticks: int, folder: Path) -> dict[str, Any]:
    """Trains in a process of its own; returns what its ``summary.json`` holds."""
    command = [
        *(sys.executable, "-m", "experiments.cli", "train"),
        *(f"runtime={runtime}", f"seed={SEED}", f"run.dir={folder}"),
        *(f"train.max_ticks={ticks}", "run.figures=false", "run.tensorboard=false"),
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        try:
            output, _ = process.communicate(timeout=TIMEOUT_S)
        except BaseException:
            _stop(process)
            raise
    if process.returncode != 0:
        raise RunError(f"risfleet train runtime={runtime} failed: {output[-2000:]}")
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return summary


def _stop(process: subprocess.Popen[str]) -> None:
    """Asks a run to stop what it has started and to end; ends it if it does not."""
    process.terminate()
    try:
        process.wait(GRACE_S)
    except subprocess.TimeoutExpired:
        process.kill()
