"""A tiny task for the tests of whole runs, and ways to play it."""

from __future__ import annotations

import dataclasses
import fcntl
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from numpy.typing import NDArray

# No deadlines: the machine may be busy.
settings.register_profile("quick", deadline=None, max_examples=15)
settings.register_profile("default", deadline=None, max_examples=50)
settings.register_profile("thorough", deadline=None, max_examples=300)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "default"))

TINY = (
    "runtime=local",
    "env.room.width_m=8",
    "env.room.depth_m=6",
    "env.room.cell_m=1.0",
    "env.walls.segments=[[0,3,4,3]]",
    "env.ap.position_m=[4,6,2]",
    "env.ris.position_m=[8,2,2]",
    "env.ris.side=4",
    "env.tasks.destinations_m=[[7.5,2.5],[1.5,1.5],[5.5,5.5]]",
    "env.tasks.start_distance_m=2",
    "env.tasks.destination_spacing_m=1",
    "env.motion.max_slots=25",
    "agent.hidden=[13,11]",
    "agent.batch_size=8",
    "agent.learn_from=8",
    "agent.replay_size=64",
    "agent.learning_rate=0.01",
    "agent.target.every=10",
    "agent.epsilon.ticks=150",
    "federation.every=10",
    "train.max_ticks=100",
    "evaluation.every=2",
    "evaluation.episodes=4",
    "run.figures=false",
    "run.tensorboard=false",
)
"""Three robots in a room of 48 cells that learn from their eighth transition on."""


BUILDING = (
    "env.robots=2",
    "env.motion.max_slots=12",
    "agent.epsilon.ticks=40",
    "rooms.count=3",
    "rooms.held_out=1",
    "rooms.every=2",
    "federation.every=5",
    "train.episodes=100000000",
    "train.max_ticks=40",
    "evaluation.every=3",
    "evaluation.episodes=2",
    "state.every=4",
)
"""On top of it: three rooms of two robots and one held out, in four rounds of ten ticks."""


@pytest.fixture(autouse=True)
def _one_at_a_time(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[None]:
    """Tests that start Ray or Flower wait for each other, on whichever workers they are."""
    if request.node.get_closest_marker("flower") is None:
        yield
        return
    folder = tmp_path_factory.getbasetemp()
    common = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder
    with (common / "flower.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@pytest.fixture(autouse=True, scope="session")
def _no_machine_crashes() -> Iterator[None]:
    """Files need not outlast one, and to wait for the disk takes most of a tiny run's time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda descriptor: None)
        yield


def changed(config: Any, changes: Mapping[str, Any]) -> Any:
    """A copy of a configuration with values set by their dotted keys."""
    for key, value in changes.items():
        first, _, rest = key.partition(".")
        inner = changed(getattr(config, first), {rest: value}) if rest else value
        config = dataclasses.replace(config, **{first: inner})
    return config


@dataclasses.dataclass
class Watcher:
    """A run's observer: what it was told, window by window."""

    started: int = 0
    episodes: list[tuple[int, int]] = dataclasses.field(default_factory=list)
    windows: list[NDArray[np.float32]] = dataclasses.field(default_factory=list)
    ticks: list[int] = dataclasses.field(default_factory=list)

    def on_start(self) -> None:
        """Counts starts."""
        self.started += 1

    def on_episode(self, progress: Any, measures: Any) -> None:
        """Keeps the episode's number and the tick at its end."""
        self.episodes.append((progress.episodes, progress.tick))

    def on_window(self, progress: Any, robots: NDArray[np.float32], ap: Any) -> None:
        """Keeps the weights after the aggregation and the tick."""
        self.windows.append(robots.copy())
        self.ticks.append(progress.tick)


@dataclasses.dataclass
class Played:
    """What a run came to."""

    robots: NDArray[np.float32]
    ap: NDArray[np.float32]
    run: Any
    watcher: Watcher

    @property
    def digests(self) -> tuple[str, str]:
        """Of the robots' and of the access point's weights."""
        from storage.checkpoint_files import digest

        return digest(self.robots), digest(self.ap)


@pytest.fixture(scope="session")
def _tiny_defaults() -> Any:
    from agent import single_threaded
    from conf import compose

    single_threaded()
    return compose(TINY)


@pytest.fixture
def tiny(_tiny_defaults: Any) -> Callable[..., Any]:
    """Makes the tiny task's configuration, with values changed by their dotted keys."""

    def make(changes: Mapping[str, Any] | None = None) -> Any:
        return changed(_tiny_defaults, changes or {})

    return make


@pytest.fixture(scope="session")
def _building_defaults(_tiny_defaults: Any) -> Any:
    from conf import overridden

    return overridden(_tiny_defaults, BUILDING)


@pytest.fixture(scope="session")
def tiny_building(_building_defaults: Any) -> Callable[..., Any]:
    """Makes the tiny building's configuration, with values changed by their dotted keys."""

    def make(changes: Mapping[str, Any] | None = None) -> Any:
        return changed(_building_defaults, changes or {})

    return make


@pytest.fixture
def play() -> Callable[..., Played]:
    """Plays a run without a folder: ``play(config, blocks)`` or ``play(config, fleet=...)``."""

    def make(
        config: Any,
        blocks: Sequence[tuple[int, ...]] | None = None,
        *,
        fleet: Any = None,
        stop: Callable[[], bool] = lambda: False,
    ) -> Played:
        from conf import robot_network
        from env.scenario import Scenario
        from env.seeding import Stream, stream
        from env.world import World
        from training.controllers.access_point import AccessPoint
        from training.coordinator import Coordinator
        from training.exchange.federation import build_federation

        initial = robot_network(config).initial_pair(stream(config.seed, Stream.WEIGHTS))
        if fleet is None:
            fleet = _local_fleet(config, blocks or [tuple(range(config.env.robots))], initial)
        scenario = Scenario.drawn(config.env, config.seed)
        world = World(scenario, stream(config.seed, Stream.WORLD), config.train.worlds)
        ap, watcher = AccessPoint(config), Watcher()
        federation = build_federation(config)
        run = Coordinator(config, world, ap, fleet, federation, watcher, stop)
        return Played(run.run(initial), ap.weights(), run, watcher)

    return make


def _local_fleet(
    config: Any, blocks: Sequence[tuple[int, ...]], initial: NDArray[np.float32]
) -> Any:
    from client_app.robots import RobotGroup
    from lockstep import InProcessFleet
    from training.partition import step_layout

    groups = []
    for block in blocks:
        group = RobotGroup(config, block)
        group.download(0, initial)
        groups.append((block, group))
    return InProcessFleet(groups, step_layout(config))


@pytest.fixture(scope="session")
def tiny_overrides() -> tuple[str, ...]:
    """The tiny task as Hydra overrides, for commands."""
    return TINY


@pytest.fixture(scope="session")
def tiny_run(_tiny_defaults: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished tiny run, with figures and events; not to be written to."""
    from experiments.runtimes import local
    from training.run_folder import RunFolder

    folder: Path = tmp_path_factory.mktemp("tiny") / "run"
    changes = {"run.dir": str(folder), "run.figures": True, "run.tensorboard": True}
    local.train(changed(_tiny_defaults, changes), RunFolder(folder))
    return folder


@pytest.fixture(scope="session")
def building_overrides() -> tuple[str, ...]:
    """The tiny building as Hydra overrides, for commands."""
    set_anew = {item.partition("=")[0] for item in BUILDING}
    kept = [item for item in TINY if item.partition("=")[0] not in set_anew]
    return (*kept, *BUILDING)


@pytest.fixture(scope="session")
def building_run(
    tiny_building: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The folder of a finished building, with figures; not to be written to."""
    from experiments.runtimes import local
    from training.run_folder import RunFolder

    folder: Path = tmp_path_factory.mktemp("building") / "run"
    config = tiny_building({"run.dir": str(folder), "run.figures": True, "run.tensorboard": True})
    local.train(config, RunFolder(folder))
    return folder
