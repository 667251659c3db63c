"""Flower's simulation runtime on this machine, and whether its engine lives.

Flower itself notices its engine's death late.
"""

from __future__ import annotations

import time
from pathlib import Path

from experiments.flower.control import RunState, Status
from experiments.flower.environment import FlowerError
from experiments.flower.session import Session
from experiments.flower.superlink import SuperLink
from repeatable.processes import Process, command, identify, members
from training.engine_limits import max_concurrent_clients

_SIMULATION = "flwr-simulation"
_CLIENT = "ray::ClientAppActor"
_RAY = "raylet/raylet"

_ENDING_S = 10.0
"""How long the engine may outlive Ray: after an app that raised, Ray ends before that is said."""


class Engine:
    """The engine's processes, found below the SuperLink's (on Linux; elsewhere all seems well).

    Attributes:
        running: whether the simulation's main process was there at the last look, and Ray's too,
            or not long gone, as long as that has to start the clients. Once they are there, they
            need it no more.
        has_clients: whether a process that runs clients has ever been there.
    """

    def __init__(self, superlink: Process) -> None:
        """Watches below the process of a SuperLink."""
        self._superlink = superlink
        self._can_look = bool(command(superlink)) and identify(superlink.pid) is not None
        self.running = True
        self.has_clients = not self._can_look
        self._has_ray = False
        self._stranded_at: float | None = None

    def look(self) -> None:
        """Looks at the processes again; a few milliseconds."""
        if not self._can_look:
            return
        commands = [command(row) for row in members(None, [self._superlink])]
        ray = any(_RAY in text.partition(" ")[0] for text in commands)
        if ray or self.has_clients or not self._has_ray:
            self._stranded_at = None
        elif self._stranded_at is None:
            self._stranded_at = time.monotonic()
        ending = self._stranded_at is None or time.monotonic() - self._stranded_at < _ENDING_S
        self.running = any(_SIMULATION in text for text in commands) and ending
        self._has_ray |= ray
        self.has_clients |= any(text.startswith(_CLIENT) for text in commands)


class SimulationSuperLink(SuperLink):
    """A SuperLink that runs the app on Flower's simulation engine, with Ray."""

    def __init__(
        self, *, clients: int = 1, log_path: Path, start_timeout_s: float = 120.0, port: int = 0
    ) -> None:
        """Prepares so many Flower clients, all of which run at the same time.

        All else is as in `SuperLink`; a run's first client, too, has `start_timeout_s` to appear.

        Raises:
            FlowerError: more clients than can run at once.
        """
        super().__init__(log_path=log_path, start_timeout_s=start_timeout_s, port=port)
        most = max_concurrent_clients()
        if not 1 <= clients <= most:
            raise FlowerError(
                f"federation.clients is {clients}, but Flower's simulation engine runs between 1 "
                f"and {most} clients at once on this machine (its CPUs + 4, 32 at most)."
            )
        self.simulated = clients
        self._engine: Engine | None = None

    def _options(self, session: Session) -> list[str]:
        return ["--insecure", "--simulation"]

    def _on_start(self) -> None:
        self._engine = Engine(self._root())

    def _death(self) -> str:
        assert self._engine is not None
        self._engine.look()
        if self._engine.running:
            return ""
        return "the simulation's process, or Ray's, ended without a word"

    def _require_progress(self, run_id: int, status: Status) -> None:
        super()._require_progress(run_id, status)
        late = status.state is RunState.RUNNING and self._waited_s(run_id) > self._start_timeout_s
        if late and self._engine is not None and not self._engine.has_clients:
            seconds = f"{self._start_timeout_s:.0f} s"
            message = f"No client process has started within {seconds}: does Ray work here?"
            raise FlowerError(message, self.log_tail(run_id))
