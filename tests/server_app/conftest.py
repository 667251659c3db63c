"""Runs on a fake grid with the real ClientApp, and their bits in one process."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import pytest
from fake_grid import FakeGrid
from flwr.serverapp import Grid
from flwr.supercore.task_identity import TaskIdentity

from client_app.robots import RobotGroup
from conf import Config, fingerprint, from_yaml, to_yaml
from experiments.runtimes import local
from lockstep import LinkServer
from server_app import clients as clients_module
from server_app.clients import Clients
from server_app.recovery import RecoveringTrainer
from training.checkpoint import latest
from training.run_folder import RunFolder

Tiny = Callable[..., Config]
PATIENCE_S = 120.0
RUN = "0123456789abcdef"


@pytest.fixture(scope="module")
def _modules_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("run")


@pytest.fixture
def tmp_path(_modules_folder: Path) -> Path:
    """The same folder for all tests of a module, and empty: their configurations are read once."""
    shutil.rmtree(_modules_folder)
    _modules_folder.mkdir()
    return _modules_folder


@pytest.fixture
def hurried_flower(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets messages be made outside of Flower, and clients be looked after more often."""
    for name in ("_task_id", "_run_id", "_node_id"):
        monkeypatch.setattr(TaskIdentity, name, 1)
    monkeypatch.setattr(clients_module, "TEND_S", 0.05)


@pytest.fixture
def deployed(tiny: Tiny, tmp_path: Path) -> Tiny:
    """The tiny task as it would be deployed, with a checkpoint every second window."""

    def make(changes: dict[str, Any] | None = None) -> Config:
        standard = {
            "runtime.name": "deployment",
            "runtime.start_timeout_s": PATIENCE_S,
            "federation.link.timeout_s": 5.0,
            "federation.loss_timeout_s": PATIENCE_S,
            "train.max_ticks": 120,
            "evaluation.every": 10**6,
            "state.every": 2,
            "run.dir": str(tmp_path / "run"),
            "run.id": RUN,
        }
        return tiny({**standard, **(changes or {})})

    return make


@pytest.fixture
def leaves_no_thread() -> Iterator[None]:
    """Nobody plays on in the folder that the next test takes over."""
    before = set(threading.enumerate())
    yield
    for thread in set(threading.enumerate()) - before:
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


@pytest.fixture
def run(hurried_flower: None, leaves_no_thread: None) -> Callable[..., dict[str, Any]]:
    """Trains on a fake grid; returns the summary."""

    def make(config: Config, grid: FakeGrid, resumes: bool = False) -> dict[str, Any]:
        folder = Path(str(config.run.dir))
        timeout_s = config.federation.link.timeout_s
        link = LinkServer(fingerprint=fingerprint(), timeout_s=timeout_s)
        from_yaml(to_yaml(config))  # all clients read it, and find it read
        try:
            clients = Clients(config, cast(Grid, grid), link, sorted(grid.nodes)[:3])
            resumed = latest(folder / "state", 0) if resumes else None
            RecoveringTrainer(config, RunFolder(folder), link, clients).train(resumed)
        finally:
            link.close("the run has ended")
        summary: dict[str, Any] = json.loads((folder / "summary.json").read_text())
        return summary

    return make


@pytest.fixture(scope="module")
def _known_digests() -> dict[str, dict[str, str]]:
    return {}


@pytest.fixture
def digests(
    _known_digests: dict[str, dict[str, str]], tmp_path: Path
) -> Callable[[Config], dict[str, str]]:
    """The digests of a run that loses nobody, in one process; played once for a module's tests."""

    def make(config: Config) -> dict[str, str]:
        text = to_yaml(config)
        if text not in _known_digests:
            folder = RunFolder(tmp_path / "whole")
            _known_digests[text] = local.train(config, folder)["digest"]
        return _known_digests[text]

    return make


@pytest.fixture
def at_tick(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Lets a robot's process raise an error, once or so often, when it is told of a tick."""

    def make(tick: int, robot: int, error: Exception, times: int = 1) -> None:
        step, left = RobotGroup.step, [times]

        def failing(self: RobotGroup, told: Any) -> Any:
            if told.tick == tick and robot in self.robots and left[0]:
                left[0] -= 1
                raise error
            return step(self, told)

        monkeypatch.setattr(RobotGroup, "step", failing)

    return make
