"""Launchers of Flower's runtimes: what they start ends with them."""

from experiments.flower.environment import FlowerError
from experiments.flower.manifest import Components
from experiments.flower.superlink import RunState, SimulationSuperLink, Status

__all__ = [
    "Components",
    "FlowerError",
    "RunState",
    "SimulationSuperLink",
    "Status",
]
