"""Whether the simulation engine below a SuperLink lives: Flower itself notices its death late."""

from __future__ import annotations

from experiments.flower.processes import Process, command, identify, members

_SIMULATION = "flwr-simulation"
_CLIENT = "ray::ClientAppActor"


class Engine:
    """The engine's processes, found below the SuperLink's (on Linux; elsewhere all seems well).

    Attributes:
        running: whether the simulation's main process was there at the last look.
        has_clients: whether a process that runs clients has ever been there.
    """

    def __init__(self, superlink: Process) -> None:
        """Watch below the process of a SuperLink."""
        self._superlink = superlink
        self._can_look = bool(command(superlink)) and identify(superlink.pid) is not None
        self.running = True
        self.has_clients = not self._can_look

    def look(self) -> None:
        """Look at the processes again; a few milliseconds."""
        if not self._can_look:
            return
        commands = [command(row) for row in members(None, [self._superlink])]
        self.running = any(_SIMULATION in text for text in commands)
        self.has_clients |= any(text.startswith(_CLIENT) for text in commands)
