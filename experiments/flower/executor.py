"""Whether the SuperExec of a SuperLink or SuperNode lives, which starts the apps' processes.

Flower starts one beside each of them and never looks at it again: without it no app is started any
more, and nobody says so.
"""

from __future__ import annotations

from collections.abc import Iterable

from repeatable.processes import Process, command, table

NAME = "flower-superexec"


class Executor:
    """The SuperExec below its owner, a SuperLink or SuperNode.

    Attributes:
        seen: whether it has ever been there (on Linux; elsewhere it cannot be told from others).
    """

    def __init__(self, owner: Process) -> None:
        self._owner = owner
        self.seen = False
        self._dead: set[Process] = set()

    def has_died(self, family: Iterable[Process]) -> bool:
        """Whether it was there and is no more.

        One that died before anybody saw it is still told: its owner does not clear it away. What
        ended just now may be another child, which its owner waits for, so it takes two looks.

        Args:
            family: the owner and all below it, as they are now.
        """
        if any(NAME in command(row) for row in family):
            self.seen = True
            return False
        ended = {row for row in table().values() if row.zombie and row.parent == self._owner.pid}
        stayed, self._dead = ended & self._dead, ended
        return self.seen or bool(stayed)
