"""The lockstep link between the world and the robots' clients: calls, or frames over TCP."""

from lockstep.client import serve
from lockstep.errors import LinkError, LinkTimeout, RobotFailed, RobotLost, ServerLost
from lockstep.interface import Fleet, Robots
from lockstep.local import InProcessFleet
from lockstep.messages import UPDATE, Expect, Flag, Layout, Payload, Step
from lockstep.server import LinkServer

__all__ = [
    "UPDATE",
    "Expect",
    "Flag",
    "Fleet",
    "InProcessFleet",
    "Layout",
    "LinkError",
    "LinkServer",
    "LinkTimeout",
    "Payload",
    "RobotFailed",
    "RobotLost",
    "Robots",
    "ServerLost",
    "Step",
    "serve",
]
