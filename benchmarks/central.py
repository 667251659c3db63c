"""What one agent for everything costs in a joint step, against F-DRL's agents."""

from __future__ import annotations

from agent import single_threaded
from benchmarks.local import CentralRun, LocalRun, ServerSide, configured
from benchmarks.result import Result, micro, take_turns
from conf import joint_actions

HOW = (
    "processor time of a joint step with {} over that with F-DRL, K = {}, all agents in this"
    " process and learning, blocks in turn"
)
NAMES = {"centralized": "one DQN over {:,} joint actions", "branching": "one network with {} heads"}
WARM_UP = 150


def central(*, quick: bool = False) -> list[Result]:
    """Measures the results whose names begin with ``centralized_`` and ``branching_``."""
    single_threaded()
    return [result for robots in (2, 3) for result in _against_federated(robots, quick)]


def _against_federated(robots: int, quick: bool) -> list[Result]:
    task = f"env.robots={robots}"
    configs = {name: configured(task, f"baseline={name}") for name in NAMES}
    variants: dict[str, ServerSide] = {name: CentralRun(found) for name, found in configs.items()}
    variants["federated"] = LocalRun(configured(task))
    for run in variants.values():
        run.play(WARM_UP)
    blocks = 3 if quick else 7
    taken = take_turns({name: run.play for name, run in variants.items()}, 25, blocks)
    details = {f"{name}_us": micro(seconds) for name, seconds in taken.items()}
    counts = {"centralized": joint_actions(configs["centralized"]), "branching": robots + 1}
    return [
        Result.over(
            f"{name}_step_vs_federated_k{robots}",
            taken[name] / taken["federated"],
            "ratio",
            HOW.format(NAMES[name].format(counts[name]), robots),
            details=details,
        )
        for name in NAMES
    ]
