"""What can go wrong on the link; every exception derives from `LinkError`."""

# ruff: noqa: N818 - these names are read in messages and `except` lines: they say what happened.

from collections.abc import Sequence

TEXT_LIMIT = 1000


def one_line(text: object, limit: int = TEXT_LIMIT) -> str:
    """Text as one printable line of at most `limit` characters, safe to log."""
    line = "".join(c if c.isprintable() else " " for c in str(text)[: 4 * limit]).strip()
    return line if len(line) <= limit else line[: limit - 3] + "..."


def described(error: BaseException) -> str:
    """An exception as one line: its type and what it says."""
    return one_line(f"{type(error).__name__}: {error}" if str(error) else type(error).__name__)


def named(robots: Sequence[int]) -> str:
    """Robots as a reader expects them: `robot 2`, `robots 0, 1`."""
    return f"robot{'s' if len(robots) != 1 else ''} {', '.join(map(str, robots))}"


class LinkError(RuntimeError):
    """Anything that the link raises."""


class FrameError(LinkError):
    """A frame is malformed, over-long or not what was expected."""


class ProtocolError(LinkError):
    """This side was asked for something that the conversation is not at."""


class LinkTimeout(LinkError):
    """A deadline has passed."""


class _RobotError(LinkError):
    _verb: str

    def __init__(self, robots: Sequence[int], where: str, reason: str) -> None:
        self.robots = tuple(robots)
        super().__init__(f"{named(robots)} {self._verb} {where}: {reason}")


class RobotLost(_RobotError):
    """The connection of a client broke, or had to be closed."""

    _verb = "lost"


class RobotFailed(_RobotError):
    """A client said why it stops."""

    _verb = "failed"


class ServerLost(LinkError):
    """The server has gone."""


class Disconnected(ServerLost):
    """The connection to the server broke, without a word of why."""


class Refused(LinkError):
    """The server does not let this client in, and says why."""
