"""The processes of a run under test: who is who, who is still there, who is to die."""

from __future__ import annotations

import os
import random
import re
import signal
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from repeatable.processes import Process, command, identify, members

MARK = "RISFLEET_CHAOS"
"""An environment variable that every process of a run under test inherits from the first."""

LAUNCHER = "launcher"
OTHER = "other"
ROLES = {
    "ClientApp": r"^ray::ClientAppActor|/flwr-clientapp",
    "ServerApp": r"/flwr-serverapp",
    "ServerApp (engine)": r"/flwr-simulation",
    "SuperNode": r"/flower-supernode",
    "SuperExec": r"/flower-superexec",
    "SuperLink": r"/flower-superlink",
    "flwr command": r"/flwr ",
    "raylet": r"/raylet/raylet",
    "Ray GCS": r"/gcs_server",
    "Ray agent": r"^ray::|/dashboard/agent\.py|/runtime_env/agent/main\.py",
    "Ray service": r"/site-packages/ray/",
}
"""What a process of Flower's or Ray's is, by the first pattern that its command line holds."""

_POLL_S = 0.05
_SETTLE_S = 1.0
"""A process that is just being started shows neither its environment nor, if the one that started
it has died, a parent: only when none was seen for this long, all are gone."""


def role_of(line: str, roles: Mapping[str, str] = ROLES) -> str:
    """The role of a process, the launcher aside, by its command line."""
    return next((role for role, pattern in roles.items() if re.search(pattern, line)), OTHER)


class ProcessTracker:
    """A launcher and all that comes of it, wherever it has moved.

    A process belongs if it carries the mark, was seen below one that does, or is below one of
    these. Ray's workers overwrite the memory that holds their environment, so it takes both.
    """

    def __init__(self, launcher: int, mark: str, roles: Mapping[str, str] = ROLES) -> None:
        """Watch a process that was just started with ``MARK=mark`` in its environment."""
        self._mark, self._roles = mark, roles
        self._launcher = identify(launcher)
        self._known: set[Process] = {self._launcher} if self._launcher is not None else set()

    def alive(self) -> set[Process]:
        """The processes that are there now."""
        alive = members(self._mark, self._known, variable=MARK)
        self._known |= alive
        return alive

    def roles(self) -> dict[str, list[Process]]:
        """The processes that are there now, by role; the oldest number first."""
        found: dict[str, list[Process]] = {}
        for row in sorted(self.alive(), key=lambda row: row.pid):
            line = command(row)
            if line:  # none: it is about to go
                role = LAUNCHER if row == self._launcher else role_of(line, self._roles)
                found.setdefault(role, []).append(row)
        return found

    def wait_gone(self, within_s: float) -> tuple[set[Process], float]:
        """Wait until none is there, for ``within_s`` seconds at most.

        Returns:
            Those that still are there, and the seconds until the last was seen.
        """
        began = seen = time.monotonic()
        left = self.alive()
        while (now := time.monotonic()) < began + within_s:
            if left:
                seen = now
            elif now - seen > _SETTLE_S:
                break
            time.sleep(_POLL_S)
            left = self.alive()
        return left, seen - began

    def end(self) -> None:
        """Kill whatever is left, process by process."""
        deadline = time.monotonic() + 10.0
        while (left := self.alive()) and time.monotonic() < deadline:
            for row in left:
                if (target := aim(row)) is not None:
                    target.kill()
            time.sleep(_POLL_S)


@dataclass(frozen=True)
class KillTarget:
    """A process held by a descriptor, so that a kill is quick and can hit no other."""

    process: Process
    handle: int

    def kill(self) -> bool:
        """Kill -9; False if it had gone."""
        try:
            signal.pidfd_send_signal(self.handle, signal.SIGKILL)
        except ProcessLookupError:
            return False
        finally:
            os.close(self.handle)
        return True


def aim(process: Process) -> KillTarget | None:
    """Take hold of a process; None if it has gone."""
    try:
        handle = os.pidfd_open(process.pid)
    except ProcessLookupError:
        return None
    if identify(process.pid) != process:  # its number is another's by now
        os.close(handle)
        return None
    return KillTarget(process, handle)


class Deck:
    """Whom to kill next: each role has its turn, in random order, as soon as it is there."""

    def __init__(self, roles: Sequence[str], rng: random.Random) -> None:
        self._roles, self._rng = roles, rng
        self._cards: list[str] = []

    def pick(self, there: Mapping[str, Sequence[Process]]) -> tuple[str, Process] | None:
        """A role and a process of it, of those that are there by role; None if none is."""
        present = [role for role in self._roles if role in there]
        if not present:
            return None
        if not any(card in present for card in self._cards):
            self._cards += self._rng.sample(present, len(present))
        role = next(card for card in self._cards if card in present)
        self._cards.remove(role)
        return role, self._rng.choice(there[role])
