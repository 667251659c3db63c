"""Whole runs in which robots hold networks that differ: the same bits however they are played."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from client_app.robots import RobotGroup
from client_app.state import CheckpointedRobots
from conf import Config, robot_network
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World
from experiments.cli import main
from lockstep import Expect, InProcessFleet, LinkServer, serve
from training import session
from training.controllers.access_point import AccessPoint
from training.coordinator import Coordinator
from training.exchange.federation import build_federation
from training.exchange.own_parts import shared_numbers
from training.partition import step_layout
from training.run_folder import RunFolder

BLOCKS = [(0, 2), (1,)]
KINDS = {
    "heads": {"federation.own": "heads"},
    "normalisation": {"federation.own": "normalisation"},
    "input": {"federation.own": "input"},
    "gossip": {"strategy.name": "gossip", "strategy.graph": "random"},
}
RESUMED = {
    "heads": ["federation.own=heads"],
    "normalisation": ["federation.own=normalisation"],
    "gossip": ["strategy=gossip", "strategy.graph=random"],
    "visits": ["strategy=visits"],
}


class Silent:
    """An observer that keeps nothing."""

    def on_start(self) -> None:
        """See ``Observer.on_start``."""

    def on_episode(self, progress: Any, measures: Any) -> None:
        """See ``Observer.on_episode``."""

    def on_window(self, progress: Any, robots: Any, ap: Any) -> None:
        """See ``Observer.on_window``."""


class UploadingLink(LinkServer):
    """A link on which the run's last weights are uploaded like all others."""

    def send_step(self, tick: int, window: int, expect: Expect, updates: np.ndarray) -> None:
        """See ``Fleet.send_step``."""
        asked = Expect.WEIGHTS if expect is Expect.END_ROUND else expect
        super().send_step(tick, window, asked, updates)


def initial(config: Config) -> NDArray[np.float32]:
    first = robot_network(config).initial_weights(stream(config.seed, Stream.WEIGHTS))
    return np.stack([first, first])


def trained(config: Config, fleet: Any) -> NDArray[np.float32]:
    """The robots' weights after a run with a fleet that holds the first model."""
    world = World(Scenario.drawn(config.env, config.seed), stream(config.seed, Stream.WORLD))
    federation = build_federation(config)
    run = Coordinator(config, world, AccessPoint(config), fleet, federation, Silent())
    return run.run(initial(config))


def in_process(config: Config) -> NDArray[np.float32]:
    groups = [(tuple(range(3)), RobotGroup(config, range(3)))]
    for _, group in groups:
        group.download(0, initial(config))
    return trained(config, InProcessFleet(groups, step_layout(config)))


def over_tcp(config: Config) -> NDArray[np.float32]:
    """The same with each block of robots behind a socket, on a thread of its own."""
    layout, parameters = step_layout(config), robot_network(config).parameters
    link = UploadingLink("127.0.0.1", 0, fingerprint="test", timeout_s=60, layout=layout)
    tokens = [f"secret-{robot}" for robot in range(3)]

    def client(block: tuple[int, ...]) -> None:
        own, robots = [tokens[robot] for robot in block], CheckpointedRobots(config, block, None)
        options = {"fingerprint": "test", "timeout_s": 60.0, "n_parameters": parameters}
        serve(link.address, block, own, robots, layout=layout, **options)

    threads = [threading.Thread(target=client, args=(block,), daemon=True) for block in BLOCKS]
    try:
        link.admit(BLOCKS, dict(enumerate(tokens)), (2, parameters))
        for thread in threads:
            thread.start()
        link.wait_connected(60)
        link.begin(0, initial(config))
        return trained(config, link)
    finally:
        link.close()
        for thread in threads:
            thread.join(60)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_own_networks_are_the_same_bits_over_the_link_as_within_a_process(
    tiny: Callable[..., Config], kind: str
) -> None:
    config = tiny({**KINDS[kind], "train.max_ticks": 50})
    here, there = in_process(config), over_tcp(config)
    assert here.tobytes() == there.tobytes()
    assert not (here[0] == here[1]).all()


def test_robots_differ_in_their_own_layers_alone(tiny: Callable[..., Config]) -> None:
    config = tiny({"federation.own": "heads", "train.max_ticks": 50})
    robots = in_process(config)
    shared = shared_numbers(robot_network(config), "heads")
    assert (robots[:, :, shared] == robots[0][:, shared]).all()
    assert (robots[0][0, ~shared] != robots[1][0, ~shared]).any()


@pytest.mark.parametrize("kind", RESUMED)
def test_a_run_that_died_ends_in_the_same_bits_and_can_be_played(
    kind: str,
    tiny_overrides: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole, died = tmp_path / "whole", tmp_path / "died"
    given = ["train", *tiny_overrides, *RESUMED[kind], "train.max_ticks=70", "state.every=3"]
    assert main([*given, f"run.dir={whole}"]) == 0
    save = session.save_server  # type: ignore[attr-defined]

    def fatal(writer: Any, state: Path, window: int, *rest: Any) -> None:
        if window == 6:
            raise OSError("the machine is gone")
        save(writer, state, window, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(session, "save_server", fatal)
        assert main([*given, f"run.dir={died}"]) == 1
    assert main(["train", f"resume={died}"]) == 0
    one, again = (
        json.loads((folder / "summary.json").read_text())["digest"] for folder in (whole, died)
    )
    assert one == again
    folder = RunFolder(whole)
    robots, _ = folder.read_networks(folder.read_config())
    assert (robots[0] == robots[1]).all() == (kind == "visits")
    assert main(["evaluate", str(whole), "--episodes", "2"]) == 0
