"""Runs to look at."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from conf import Config
from experiments.runtimes import local
from experiments.viewer.follower import Follower
from experiments.viewer.server import WatchServer
from training.run_folder import RunFolder


@pytest.fixture
def trained(tiny: Callable[..., Config], tmp_path: Path) -> Callable[..., Path]:
    """Trains a tiny run with some keys set; returns its folder."""

    def train(changes: dict[str, Any]) -> Path:
        folder = tmp_path / "run"
        keys = {"run.dir": str(folder), "train.max_ticks": 10}
        local.train(tiny({**keys, **changes}), RunFolder(folder))
        return folder

    return train


@pytest.fixture
def watched() -> Callable[..., Any]:
    """Serves a run's page while a block runs."""

    @contextmanager
    def serve(run: Path) -> Iterator[WatchServer]:
        with WatchServer(Follower(RunFolder(run))) as server:
            thread = Thread(target=server.serve_forever, args=(0.05,))
            thread.start()
            try:
                yield server
            finally:
                server.shutdown()
                thread.join()

    return serve
