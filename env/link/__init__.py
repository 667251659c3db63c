"""The lockstep link between the world and the robots' clients: calls, or frames over TCP."""

from env.link.client import serve
from env.link.errors import (
    FrameError,
    LinkError,
    LinkTimeout,
    OutOfTurn,
    Refused,
    RobotFailed,
    RobotLost,
    ServerLost,
)
from env.link.interface import Fleet, Robots
from env.link.local import LocalFleet
from env.link.messages import UPDATE, Flag, Step, Want
from env.link.server import LinkServer

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
