"""Flower's deployment runtime on loopback: a SuperLink and SuperNodes, started and looked after."""

from __future__ import annotations

import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path

from experiments.flower import commands
from experiments.flower.environment import HOST, FlowerError, flower_command, free_port
from experiments.flower.executor import NAME as EXECUTOR
from experiments.flower.executor import Executor
from experiments.flower.keys import FleetKeys, NodeKeys, add_nodes, make_keys
from experiments.flower.session import Session
from experiments.flower.superlink import SuperLink
from repeatable.processes import Process, command, members, terminate

_SERVER_APP = "flwr-serverapp"
_MOST_RESTARTS = 5
_STEADY_S = 60.0
"""A SuperNode that lived this long is not one that cannot live."""
_LAST_WORDS_S = 10.0
"""For the ServerApp to say which robots a dead SuperNode held, before all is ended."""


@dataclass
class _Node:
    """A SuperNode.

    Attributes:
        number: from 0.
        process: of the SuperNode itself.
        root: the same, as `processes` knows it.
        executor: the process that starts its clients.
        began: when it was started, monotonic, in s.
        restarts: in a row, none of which lived long.
        family: itself and all below it, as last seen.
    """

    number: int
    process: subprocess.Popen[bytes]
    root: Process
    executor: Executor
    began: float = field(default_factory=time.monotonic)
    restarts: int = 0
    family: set[Process] = field(default_factory=set)


class Federation(SuperLink):
    """A SuperLink that SuperNodes join, all on this machine."""

    def __init__(
        self,
        *,
        nodes: int,
        secure: bool = False,
        revive: bool = True,
        log_path: Path,
        start_timeout_s: float = 120.0,
        port: int = 0,
    ) -> None:
        """Prepares so many SuperNodes; all else is as in `SuperLink`.

        Where it is `secure`, the SuperLink has a certificate, and SuperNodes keys that it knows;
        `revive` says whether a SuperNode that has died is started anew.
        """
        super().__init__(log_path=log_path, start_timeout_s=start_timeout_s, port=port)
        self._count, self._secure, self._revive = nodes, secure, revive
        self._keys: FleetKeys | None = None
        self._spare: list[NodeKeys] = []
        self._nodes: list[_Node] = []
        self._has_server_app = False
        self._lost = ""
        self._lost_at = 0.0

    def _options(self, session: Session) -> list[str]:
        if not self._secure:
            return ["--insecure"]
        if self._keys is None:
            self._keys = make_keys(session.folder / "keys", [HOST], self._count)
            self._authority, self._spare = self._keys.authority, list(self._keys.nodes)
        return self._keys.options()

    def _on_start(self) -> None:
        self._nodes = [self._started(number) for number in range(self._count)]

    def _death(self) -> str:
        """Looks after the SuperNodes and says whether the ServerApp has died.

        Raises:
            FlowerError: a SuperNode dies again and again.
        """
        for node in self._nodes:
            self._look_after(node)
        if self._lost and time.monotonic() - self._lost_at > _LAST_WORDS_S:
            return self._lost
        below = [command(row) for row in members(None, [self._root()])]
        running = any(_SERVER_APP in text for text in below)
        died, self._has_server_app = self._has_server_app and not running, running
        return "the ServerApp's process ended without a word" if died else ""

    def _look_after(self, node: _Node) -> None:
        """Starts a SuperNode anew that has died, or cannot start clients any more."""
        code = node.process.poll()
        family = members(None, [node.root])
        node.family = family or node.family
        crippled = node.executor.has_died(family)
        if code is None and not crippled:
            return
        what = f"ended with status {code}" if code is not None else f"lost its {EXECUTOR}"
        if not self._revive:
            if not self._lost:
                terminate(None, node.family)  # by its client's end the ServerApp notices
                self._lost, self._lost_at = f"SuperNode {node.number} {what}", time.monotonic()
            return
        lived_s = time.monotonic() - node.began
        node.restarts = 0 if lived_s > _STEADY_S else node.restarts + 1
        if node.restarts > _MOST_RESTARTS:
            raise FlowerError(f"SuperNode {node.number} {what} again and again.")
        terminate(None, node.family)
        fresh = self._started(node.number)
        fresh.restarts = node.restarts
        self._nodes[node.number] = fresh

    def _started(self, number: int) -> _Node:
        """Starts a SuperNode, with a key that no other one has had."""
        session = self._require_alive()
        assert self._log is not None
        process = session.spawn(
            [flower_command("flower-supernode"),
             "--superlink", f"{HOST}:{self._port}", "--port", str(free_port()),
             "--node-config", f"partition-id={number} num-partitions={self._count}",
             *self._identity(session)],
            self._log,
        )  # fmt: skip
        root = session.root(process)
        return _Node(number, process, root, Executor(root))

    def _identity(self, session: Session) -> list[str]:
        """Options by which a SuperNode is known.

        The SuperLink takes a key's node for online up to a minute after its death, and lets nobody
        else join with the same key meanwhile.
        """
        if self._keys is None:
            return ["--insecure"]
        key = self._spare.pop(0) if self._spare else add_nodes(self._keys.folder, 1)[0]
        commands.register_node(session, key.public)
        return key.options()
