"""What a runtime adds to a run, in bytes and seconds."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True)
class Costs:
    """What a runtime adds to a run.

    Attributes:
        flower_s: wall time after start-up in which joint steps stood still for Flower.
        client_cpu_s: processor time of other processes that hold robots.
        bytes_to_robots: bytes sent on the link.
        bytes_from_robots: bytes received on it.
        flower_bytes: bytes of weights in Flower messages, both ways.
        waited_s: wall time in which the coordinator waited for actions.
    """

    flower_s: float = 0.0
    client_cpu_s: float = 0.0
    bytes_to_robots: int = 0
    bytes_from_robots: int = 0
    flower_bytes: int = 0
    waited_s: float = 0.0

    def plus(self, other: Costs) -> Costs:
        """Both together."""
        return Costs(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def minus(self, other: Costs) -> Costs:
        """What came after the other."""
        return Costs(*(getattr(self, f.name) - getattr(other, f.name) for f in fields(self)))
