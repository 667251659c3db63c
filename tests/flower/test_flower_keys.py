"""The keys of ``risfleet keys`` with the real SuperLink: who is admitted, and who is not."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from experiments.flower.environment import HOST, flower_command, free_port
from experiments.flower.keys import FleetKeys, NodeKeys, make_keys
from experiments.flower.session import Session
from repeatable.processes import members

pytestmark = [pytest.mark.slow, pytest.mark.flower]
PATIENCE_S = 300.0


class Fleet:
    """A secured SuperLink, and SuperNodes that try to join it."""

    def __init__(self, session: Session, keys: FleetKeys) -> None:
        self.session, self.port = session, free_port()
        self._log = (session.folder / "superlink.log").open("ab")
        (session.folder / "config.toml").write_text(
            '[superlink]\ndefault = "risfleet"\n\n[superlink.risfleet]\n'
            f'address = "{HOST}:{self.port}"\nroot-certificates = "{keys.authority}"\n'
        )
        options = ["--host", HOST, "--port", str(self.port), *keys.options()]
        self._superlink = session.spawn([flower_command("flower-superlink"), *options], self._log)
        self._wait_for(lambda: "Uvicorn running on https" in self.said)

    @property
    def said(self) -> str:
        """The SuperLink's log."""
        return (self.session.folder / "superlink.log").read_text(errors="replace")

    def flwr(self, *arguments: str) -> dict[str, object]:
        """The answer of a `flwr` command."""
        command = [flower_command("flwr"), *arguments, "--format", "json"]
        _, output, _ = self.session.run(command, PATIENCE_S)
        answer: dict[str, object] = json.loads(output)
        return answer

    def join(self, *options: str) -> str:
        """What a SuperNode says that ends by itself."""
        command = [*self._supernode(), "--max-retries", "2", *options]
        path = self.session.folder / "supernode.log"
        with path.open("wb") as log:  # a pipe would be held open by what it has started
            child = self.session.spawn(command, log)
            assert child.wait(PATIENCE_S) != 0
        return path.read_text(errors="replace")

    def admit(self, node: NodeKeys) -> None:
        """Start a SuperNode and wait until the SuperLink has activated it."""
        child = self.session.spawn([*self._supernode(), *node.options()], subprocess.DEVNULL)
        self._wait_for(lambda: "Activated node_id" in self.said, child)

    def _supernode(self) -> list[str]:
        where = ["--superlink", f"{HOST}:{self.port}", "--port", str(free_port())]
        return [flower_command("flower-supernode"), *where]

    def _wait_for(
        self, condition: Callable[[], bool], child: subprocess.Popen[bytes] | None = None
    ) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert self._superlink.poll() is None, self.said
            assert child is None or child.poll() is None, self.said
            assert time.monotonic() < deadline, self.said
            time.sleep(0.2)


@pytest.fixture
def session() -> Iterator[Session]:
    session = Session()
    yield session
    session.stop()
    assert members(session.marker) == set()


def test_only_registered_nodes_that_know_the_superlink_are_admitted(
    session: Session, tmp_path: Path
) -> None:
    keys = make_keys(tmp_path / "keys", [HOST], 2)
    other = make_keys(tmp_path / "other", [HOST], 1)
    fleet = Fleet(session, keys)
    registered, unregistered = keys.nodes

    answer = fleet.flwr("supernode", "register", str(registered.public), "risfleet")
    assert answer["success"] is True
    assert "Failed to activate SuperNode" in fleet.join(*unregistered.options())
    assert "No SuperNode found with the given public key" in fleet.said
    keyless = ["--root-certificates", str(keys.authority)]
    assert "must be registered" in fleet.join(*keyless)
    stranger = ["--root-certificates", str(other.authority), *registered.options()[2:]]
    assert "certificate verify failed" in fleet.join(*stranger)
    assert "Failed to initialize the connection" in fleet.join("--insecure")
    assert "Activated" not in fleet.said

    fleet.admit(registered)
    nodes = fleet.flwr("supernode", "list", "risfleet")["nodes"]
    assert isinstance(nodes, list)
    assert [node["status"] for node in nodes] == ["online"]
