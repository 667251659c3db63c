"""What safety costs: checkpoints, and TLS on the link."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from agent import DQN, single_threaded
from agent.replay import RowLayout
from benchmarks.clients import Mode, connected_clients
from benchmarks.deployment import Lockstep
from benchmarks.local import ServerSide, configured, initial_weights
from benchmarks.result import Result, Threshold, micro, take_turns
from client_app.robots import RobotGroup
from client_app.state import CheckpointedRobots, save_state
from conf import Config
from lockstep import UPDATE, Expect, Flag, InProcessFleet, LinkServer
from storage.checkpoint_files import Writer
from training.checkpoint import save_server
from training.coordinator import Coordinator

CHEAP = Threshold(0.03, at_least=False)
SPAN = 2
"""Checkpoints in a block; half as many windows as lie between two follow the last one."""

CHECKPOINT_HOW = (
    "{} of joint steps with state.every=50 over those without checkpoints, less 1: 3 robots and AP"
    " in one process, replays of 50,000 full, blocks of 100 windows in turn"
)
TLS_HOW = (
    "wall time of a step and its answer with TLS 1.3 less that without: one client process on"
    " loopback, handlers that do nothing, blocks in turn"
)


def overheads(*, quick: bool = False) -> list[Result]:
    """Measures ``checkpoint_share``, ``checkpoint_cpu_share`` and ``tls_us``."""
    single_threaded()
    return [*_checkpoints(3 if quick else 11), *_tls(200 if quick else 2000, 3 if quick else 15)]


class Kept:
    """A run in this process whose replays are full and whose checkpoints are written.

    Args:
        config: of the run; ``state.every`` says how often.
        folder: for the checkpoints.
    """

    def __init__(self, config: Config, folder: Path) -> None:
        robots = tuple(range(config.env.robots))
        group = RobotGroup(config, robots)
        fill(group.agents, config)
        save_state(group, folder, 1)
        self._every, self._folder, self._writer = config.state.every, folder, Writer()
        self._keeper = CheckpointedRobots(config, robots, folder)
        self._keeper.begin(1, initial_weights(config))
        # A block's windows begin in the middle between two checkpoints, and end there.
        self._before = (config.state.every or 0) // 2
        fleet = Lockstep(InProcessFleet([(robots, self._keeper)]), self._before)
        self._side = ServerSide(config, fleet, self._keep)
        fill(self._side.ap.agent, config)

    def play(self, steps: int) -> None:
        """Takes joint steps; the server's checkpoints have been written when this returns."""
        self._side.play(steps)
        self._writer.wait()

    def close(self) -> None:
        """Ends the threads that write."""
        self._writer.close()
        self._keeper.close()

    def _keep(self, run: Coordinator) -> None:
        """Writes the server's checkpoint where one is due, as ``Session`` does."""
        window = self._before + run.progress.window
        if self._every is not None and window % self._every == 0:
            save_server(self._writer, self._folder, window, run.state(), {})


def fill(agents: DQN, config: Config) -> None:
    """Fills the replays of agents with made-up transitions."""
    rng, size, inputs = np.random.default_rng(0), config.agent.replay_size, agents.shape.inputs
    layout = RowLayout(inputs)
    rows = np.empty((size, layout.width), np.float32)
    seen, next_observation = rng.normal(size=(2, size, inputs))
    chosen = rng.integers(agents.shape.actions, size=size)
    layout.pack(
        seen, chosen, rng.normal(size=size), next_observation, rng.random(size) < 0.01, rows
    )
    for agent in range(len(agents)):
        state = agents.agent_state(agent)
        agents.restore_agent(agent, {**state, "replay": rows, "stored": np.array([size])})


def _checkpoints(blocks: int) -> list[Result]:
    config = configured()
    assert config.state.every is not None
    steps = SPAN * config.state.every * config.federation.every
    without = dataclasses.replace(config, state=dataclasses.replace(config.state, every=None))
    with tempfile.TemporaryDirectory(prefix="risfleet-bench-") as folder:
        runs = {
            "kept": Kept(config, Path(folder) / "kept"),
            "not": Kept(without, Path(folder) / "not"),
        }
        variants = {name: run.play for name, run in runs.items()}
        for play in variants.values():
            play(config.federation.every)

        def both() -> np.ndarray:
            return np.array([time.perf_counter(), time.process_time()])

        taken = take_turns(variants, steps, blocks, both)
        for run in runs.values():
            run.close()
    wall, cpu = (taken["kept"] / taken["not"] - 1).T
    details = {f"{name}_us_per_joint_step": micro(seconds[:, 0]) for name, seconds in taken.items()}
    how = CHECKPOINT_HOW.format
    return [
        Result.over("checkpoint_share", wall, "share", how("wall time"), CHEAP, details),
        Result.over("checkpoint_cpu_share", cpu, "share", how("processor time"), CHEAP, details),
    ]


class Exchanges:
    """Steps and answers on a link, nothing else."""

    def __init__(self, link: LinkServer, robots: int) -> None:
        self._link, self._tick = link, 0
        self._updates = np.zeros(robots, UPDATE)
        self._updates["flags"] = Flag.DRIVING

    def __call__(self, steps: int) -> None:
        """Takes some."""
        for _ in range(steps):
            self._link.send_step(self._tick, Mode.LINK.window(1), Expect.ACTIONS, self._updates)
            self._link.actions(self._tick)
            self._tick += 1

    def farewell(self) -> None:
        """Ends the conversation."""
        self._link.send_step(self._tick, Mode.LINK.window(1), Expect.END_ROUND, self._updates)


def _tls(steps: int, blocks: int) -> list[Result]:
    config = configured("env.robots=1")
    with ExitStack() as stack:
        links = {
            name: stack.enter_context(connected_clients(config, secure=name == "tls")).link
            for name in ("plain", "tls")
        }
        variants = {name: Exchanges(link, config.env.robots) for name, link in links.items()}
        for exchanges in variants.values():
            exchanges(steps)
        taken = take_turns(variants, steps, blocks, time.perf_counter)
        for exchanges in variants.values():
            exchanges.farewell()
    added = (taken["tls"] - taken["plain"]) * 1e6
    details = {f"{name}_us": micro(seconds) for name, seconds in taken.items()}
    return [Result.over("tls_us", added, "us", TLS_HOW, None, details)]
