"""Joint steps and updates per second of one process, from one robot to many."""

from __future__ import annotations

from agent import single_threaded
from benchmarks.local import LocalRun, configured
from benchmarks.result import Result, take_turns

ROBOTS = (1, 3, 8, 16, 32)
MOST_PROJECTED = 6  # N_P: more robots cannot have power levels of their own
STEPS = "joint steps per processor second of the local runtime with {} robots and AP, replay filled"
UPDATES = "agent updates per processor second, {} robots and AP, over those of one robot and AP"


def scaling(*, quick: bool = False) -> list[Result]:
    """Measures ``steps_per_s_k*`` and ``updates_vs_k1_k*``; sizes take turns."""
    single_threaded()
    counts = ROBOTS[:2] if quick else ROBOTS
    steps, blocks = (25, 3) if quick else (100, 7)
    runs = {str(count): _run(count) for count in counts}
    taken = take_turns({name: run.play for name, run in runs.items()}, steps, blocks)
    results = []
    for count in counts:
        per_step = taken[str(count)]
        updates = (count + 1) / per_step
        ratio = updates / (2 / taken["1"])
        details = {"updates_per_s": float(sorted(updates)[blocks // 2])}
        name = f"steps_per_s_k{count}"
        results.append(Result.over(name, 1 / per_step, "1/s", STEPS.format(count), None, details))
        if count > 1:
            name = f"updates_vs_k1_k{count}"
            results.append(Result.over(name, ratio, "ratio", UPDATES.format(count)))
    return results


def _run(robots: int) -> LocalRun:
    overrides = [f"env.robots={robots}", "env.tasks.destination_spacing_m=2"]
    if robots > MOST_PROJECTED:
        overrides.append("env.power.resolve=residual")
    run = LocalRun(configured(*overrides))
    run.play(150)
    return run
