"""Launchers of Flower's runtimes: what they start ends with them."""

from experiments.flower.connection import Connection
from experiments.flower.control import RunState, Status
from experiments.flower.engine import SimulationSuperLink
from experiments.flower.environment import FlowerError, ProcessLostError
from experiments.flower.federation import Federation
from experiments.flower.manifest import Components

__all__ = [
    "Components",
    "Connection",
    "Federation",
    "FlowerError",
    "ProcessLostError",
    "RunState",
    "SimulationSuperLink",
    "Status",
]
