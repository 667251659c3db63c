"""The lockstep link between the world and the robots' clients: calls, or frames over TCP."""

from lockstep.client import serve
from lockstep.errors import (
    FrameError,
    LinkError,
    LinkTimeout,
    OutOfTurn,
    Refused,
    RobotFailed,
    RobotLost,
    ServerLost,
)
from lockstep.interface import Fleet, Robots
from lockstep.local import LocalFleet
from lockstep.messages import UPDATE, Flag, Step, Want
from lockstep.server import LinkServer

__all__ = [
    "UPDATE",
    "Flag",
    "Fleet",
    "FrameError",
    "LinkError",
    "LinkServer",
    "LinkTimeout",
    "LocalFleet",
    "OutOfTurn",
    "Refused",
    "RobotFailed",
    "RobotLost",
    "Robots",
    "ServerLost",
    "Step",
    "Want",
    "serve",
]
