"""Whole runs by the command line, one runtime after the other, for one robot and for several.

Simulation and deployment have as many client processes, one for each robot.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.local import configured
from benchmarks.result import Result, Threshold
from training.communication import per_tick

ROBOTS = (1, 3, 6)
USUAL = 3
RUNTIMES = ("local", "simulation", "deployment")
FLOWER = Threshold(0.10, at_least=False)
DEPLOYED = Threshold(0.9, at_least=True)
TIMEOUT_S = 600.0
GRACE_S = 30.0
POLL_S = 1.0
SEED = 0
RATE_HOW = (
    "steps per second of runtime={} with {} robots, {} ticks, evaluations included, start-up and"
    " what flower_share counts left out; wall time"
)
RATIO_HOW = (
    "steady steps per second of runtime={} over runtime={}, {} robots, a client process each, same"
    " seed, {} ticks, start-up and what flower_share counts left out; runtimes in turn"
)
CPU_HOW = "processor time of the same runs, all processes, simulation over local"
FLOWER_HOW = "wall time in which joint steps stand still for Flower, after start-up; {}"
EVALUATION_HOW = "wall time of evaluations over that of training, local runs of {} ticks"
SENT_HOW = (
    "bytes of federated learning (weights up and down every N_F ticks) over those of a central"
    " learner that is sent every transition; from the default configuration alone"
)

Summary = dict[str, Any]


class RunError(RuntimeError):
    """A run failed; the message holds the end of what it printed."""


def runs(*, quick: bool = False) -> list[Result]:
    """Measures ``simulation_vs_local``, ``deployment_vs_simulation`` and what belongs to them."""
    counts, rounds, ticks = ((USUAL,), 1, 500) if quick else (ROBOTS, 2, 3000)
    results = []
    for robots in counts:
        found = _in_turn(robots, rounds, ticks)
        results += _rates(found, robots, ticks)
        if robots == USUAL:
            results += _shares(found, ticks)
    sent = per_tick(configured())
    ratio = np.array([sent["weights_over_transitions"]])
    return [*results, Result.over("weights_vs_transitions", ratio, "ratio", SENT_HOW, None, sent)]


def _in_turn(robots: int, rounds: int, ticks: int) -> dict[str, list[Summary]]:
    """Trains in each runtime, round after round, each in the reverse order of the one before."""
    order = list(RUNTIMES)
    found: dict[str, list[Summary]] = {runtime: [] for runtime in order}
    with tempfile.TemporaryDirectory(prefix="risfleet-bench-") as folder:
        for number in range(rounds):
            for runtime in order:
                place = Path(folder) / f"{runtime}-{number}"
                found[runtime].append(train(runtime, robots, ticks, place))
            order.reverse()
    return found


def _rates(found: dict[str, list[Summary]], robots: int, ticks: int) -> list[Result]:
    """Steps per second of each runtime, and their ratios, a number a round."""
    end = f"_k{robots}"
    speed = {runtime: _steady(found[runtime]) for runtime in RUNTIMES}
    digests = {json.dumps(run["digest"]) for each in found.values() for run in each}
    same = {"same_weights": float(len(digests) == 1)}
    results = [
        Result.over(f"rate_{name}{end}", speed[name], "1/s", RATE_HOW.format(name, robots, ticks))
        for name in RUNTIMES
    ]
    for runtime, other, target in (
        ("simulation", "local", None),
        ("deployment", "simulation", DEPLOYED),
    ):
        ratio = speed[runtime] / speed[other]
        how = RATIO_HOW.format(runtime, other, robots, ticks)
        name = f"{runtime}_vs_{other}{'' if robots == USUAL else end}"
        results.append(Result.over(name, ratio, "ratio", how, target, same))
    return results


def _shares(found: dict[str, list[Summary]], ticks: int) -> list[Result]:
    """What Flower, waiting and evaluations take of a run."""
    local, simulation, deployed = (found[runtime] for runtime in RUNTIMES)
    cpu = _each(simulation, "cpu_s") / _each(local, "cpu_s")
    evaluations = _each(local, "evaluation_s") / _each(local, "training_s")
    waits = deployed[-1]["communication"]["waiting"]
    details = {
        f"{name}_robot_{client['robots'][0]}": client[name]
        for client in waits
        for name in ("awaited_us", "ahead_us")
    }
    for runtime in RUNTIMES[1:]:
        details[f"{runtime}_startup_s"] = float(np.median(_each(found[runtime], "startup_s")))
        stood_still = _each(found[runtime], "flower_share") * _each(found[runtime], "training_s")
        details[f"{runtime}_flower_s"] = float(np.median(stood_still))
    shares = {"": simulation, "deployment_": deployed}
    return [
        *(
            Result.over(
                f"{name}flower_share",
                _each(each, "flower_share"),
                "share",
                FLOWER_HOW.format(f"runtime={each[0]['runtime']}"),
                FLOWER,
                details,
            )
            for name, each in shares.items()
        ),
        Result.over("simulation_cpu_vs_local", cpu, "ratio", CPU_HOW),
        Result.over("evaluation_share", evaluations, "share", EVALUATION_HOW.format(ticks)),
    ]


def _steady(summaries: Sequence[Summary]) -> NDArray[np.float64]:
    """Joint steps per second while joint steps are taken, shape (runs,)."""
    stood_still = _each(summaries, "flower_share")
    return _each(summaries, "steps_per_s") / (1 - stood_still)


def _each(summaries: Sequence[Summary], name: str) -> NDArray[np.float64]:
    return np.array([summary[name] for summary in summaries], float)


def train(
    runtime: str,
    robots: int,
    ticks: int,
    folder: Path,
    marks: Mapping[str, str] | None = None,
    watch: Callable[[], None] = lambda: None,
) -> Summary:
    """Trains in a process of its own.

    Args:
        runtime: which.
        robots: K, and as many Flower clients.
        ticks: of the run.
        folder: of the run.
        marks: further variables of the environment, which all its processes inherit.
        watch: called about once a second.

    Returns:
        What ``summary.json`` holds.

    Raises:
        RunError: it failed, or took too long.
    """
    command = [
        *(sys.executable, "-m", "experiments.cli", "train"),
        *(f"runtime={runtime}", f"seed={SEED}", f"run.dir={folder}", f"env.robots={robots}"),
        *(f"train.max_ticks={ticks}", f"federation.clients={robots}"),
        *("env.tasks.destination_spacing_m=2", "run.figures=false", "run.tensorboard=false"),
    ]
    said = folder.with_suffix(".out")
    with said.open("w", encoding="utf-8") as output:
        process = subprocess.Popen(
            command, stdout=output, stderr=subprocess.STDOUT, env={**os.environ, **(marks or {})}
        )
        try:
            _wait(process, watch)
        except BaseException:
            _stop(process)
            raise
    if process.returncode != 0:
        last = said.read_text(encoding="utf-8")[-2000:]
        raise RunError(f"risfleet train runtime={runtime} failed: {last}")
    summary: Summary = json.loads((folder / "summary.json").read_text(encoding="utf-8-sig"))
    return summary


def _wait(process: subprocess.Popen[bytes], watch: Callable[[], None]) -> None:
    for _ in range(int(TIMEOUT_S / POLL_S)):
        try:
            process.wait(POLL_S)
            return
        except subprocess.TimeoutExpired:
            watch()
    raise RunError(f"{process.args!r} took more than {TIMEOUT_S:g} s")


def _stop(process: subprocess.Popen[bytes]) -> None:
    """Asks a run to stop what it has started and to end; ends it if it does not."""
    process.terminate()
    try:
        process.wait(GRACE_S)
    except subprocess.TimeoutExpired:
        process.kill()
