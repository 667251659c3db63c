"""A deployment without Flower: what the link costs and what lockstep costs.

Three processes with one robot each and this one, with world, access point and coordinator, play
over the real link on loopback. Three kinds of block of the same number of joint steps take turns:

LOCKSTEP, the run itself; LINK, the same messages with nothing done at either end; FREE, the
same acting and learning with nothing said: the server plays with actions made up beforehand, each
client plays its last lockstep block again, all four at once, until the last one has finished.

    link_share           = processor time of LINK / processor time of LOCKSTEP, all processes
    lockstep_efficiency  = wall time of FREE / wall time of LOCKSTEP
    waiting_share        = wall time in which the server waits for actions / wall time, LOCKSTEP
    lockstep_cpu_vs_free = processor time of LOCKSTEP / processor time of FREE, all processes
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from agent import single_threaded
from benchmarks.clients import SPAN, ClientProcesses, Mode, connected_clients
from benchmarks.local import ServerSide, configured
from benchmarks.result import Result, Threshold
from conf import Config, robot_actions, robot_network
from lockstep import UPDATE, Expect, Flag, Fleet, LinkServer

TARGET = Threshold(0.02, at_least=False)
LINK_HOW = (
    "processor time of the link, both ends, handlers that do nothing, over that of a joint step in"
    " lockstep: 3 client processes and the server on loopback, no Flower"
)
FREE_HOW = (
    "wall time of the four processes acting and learning freely until the last has finished, over"
    " that of as many joint steps in lockstep"
)
WAITING_HOW = "wall time in which the server waits for actions, over that of a joint step"
CPU_HOW = "processor time of all four processes in lockstep over that of acting and learning freely"


class Lockstep:
    """A link as the coordinator's fleet; a stretch ends without a farewell.

    Args:
        link: to the robots.
        before: windows that lie before the first one of every stretch.
    """

    def __init__(self, link: Fleet, before: int = 0) -> None:
        self._link, self._before = link, Mode.LOCKSTEP.window(before)

    def send_step(self, tick: int, window: int, expect: Expect, updates: np.ndarray) -> None:
        """See ``Fleet.send_step``."""
        expect = Expect.WEIGHTS if expect is Expect.END_ROUND else expect
        self._link.send_step(tick, self._before + window, expect, updates)

    def actions(self, tick: int) -> NDArray[np.int32]:
        """See ``Fleet.actions``."""
        return self._link.actions(tick)

    def upload(self, window: int) -> NDArray[np.float32]:
        """See ``Fleet.upload``."""
        return self._link.upload(self._before + window)

    def download(self, window: int, weights: NDArray[np.float32]) -> None:
        """See ``Fleet.download``."""
        self._link.download(self._before + window, weights)

    def close(self) -> None:
        """See ``Fleet.close``."""


class FakeFleet:
    """A fleet that is nowhere: its actions and weights were made up beforehand."""

    def __init__(self, config: Config) -> None:
        rng = np.random.default_rng(0)
        robots, count = config.env.robots, robot_actions(config).count
        self._moves = rng.integers(count, size=(1024, robots)).astype(np.int32)
        size = (robots, 2, robot_network(config).parameters)
        self._weights = rng.normal(size=size).astype(np.float32)

    def send_step(self, tick: int, window: int, expect: Expect, updates: np.ndarray) -> None:
        """See ``Fleet.send_step``."""

    def actions(self, tick: int) -> NDArray[np.int32]:
        """See ``Fleet.actions``."""
        return self._moves[tick % len(self._moves)]

    def upload(self, window: int) -> NDArray[np.float32]:
        """See ``Fleet.upload``."""
        return self._weights

    def download(self, window: int, weights: NDArray[np.float32]) -> None:
        """See ``Fleet.download``."""

    def close(self) -> None:
        """See ``Fleet.close``."""


@dataclass
class Times:
    """Seconds of each block, by mode: processor time of the server, wall time; and waiting."""

    cpu: dict[Mode, list[float]] = field(default_factory=lambda: {mode: [] for mode in Mode})
    wall: dict[Mode, list[float]] = field(default_factory=lambda: {mode: [] for mode in Mode})
    waited: list[float] = field(default_factory=list)


class Server:
    """This process's part in each of the modes."""

    def __init__(self, config: Config, link: LinkServer, steps: int) -> None:
        self._config, self._link, self._steps = config, link, steps
        self._lockstep = ServerSide(config, Lockstep(link))
        self._free = ServerSide(config, FakeFleet(config))
        self._free.play(150)
        self._updates = np.zeros(config.env.robots, UPDATE)
        self._updates["flags"] = Flag.OUTCOME | Flag.DRIVING
        self._model = np.zeros((2, robot_network(config).parameters), np.float32)

    def block(self, mode: Mode, times: Times) -> None:
        """Plays one block and notes its times."""
        waited = self._lockstep.waited_s
        cpu, wall = time.process_time(), time.perf_counter()
        {Mode.LOCKSTEP: self._play, Mode.LINK: self._talk, Mode.FREE: self._let_go}[mode]()
        times.cpu[mode].append(time.process_time() - cpu)
        times.wall[mode].append(time.perf_counter() - wall)
        if mode is Mode.LOCKSTEP:
            times.waited.append(self._lockstep.waited_s - waited)

    def farewell(self) -> None:
        """Ends the conversation."""
        self._link.send_step(0, Mode.LINK.window(0), Expect.END_ROUND, self._updates)

    def _play(self) -> None:
        self._lockstep.play(self._steps)

    def _talk(self) -> None:
        """The messages of a block: as many windows, actions and exchanges of weights."""
        every, tick = self._config.federation.every, 0
        for window in range(1, self._steps // every + 1):
            at = Mode.LINK.window(window)
            for _ in range(every):
                self._link.send_step(tick, at, Expect.ACTIONS, self._updates)
                self._link.actions(tick)
                tick += 1
            self._link.send_step(tick, at, Expect.WEIGHTS, self._updates)
            self._link.upload(at)
            self._link.download(at, self._model)

    def _let_go(self) -> None:
        self._link.send_step(0, Mode.FREE.window(0), Expect.ACTIONS, self._updates)
        self._free.play(self._steps)
        self._link.actions(0)


def deployment(*, quick: bool = False) -> list[Result]:
    """Measures ``link_share``, ``lockstep_efficiency`` and what belongs to them."""
    single_threaded()
    return _results(*_measured(configured(), quick))


def measured_efficiency(config: Config, *, quick: bool = False) -> NDArray[np.float64]:
    """``lockstep_efficiency`` of each block, for any number of robots, shape (blocks,)."""
    times, _, _ = _measured(config, quick)
    return np.array(times.wall[Mode.FREE]) / np.array(times.wall[Mode.LOCKSTEP])


def _measured(config: Config, quick: bool) -> tuple[Times, dict[Mode, NDArray[np.float64]], int]:
    """Times of all blocks, processor time of all processes by mode, and steps of a block."""
    steps, blocks = (100, 2) if quick else (300, 9)
    assert steps % config.federation.every == 0
    assert steps < SPAN
    times = Times()
    with connected_clients(config) as clients:
        _play_blocks(Server(config, clients.link, steps), times, blocks)
        cpu = _processor_time(clients, times)
    return times, cpu, steps


def _play_blocks(server: Server, times: Times, blocks: int) -> None:
    """A first round fills the replays and is not counted."""
    for _ in range(2):
        server.block(Mode.LOCKSTEP, Times())
        server.block(Mode.LINK, Times())
    for _ in range(blocks):
        for mode in (Mode.LOCKSTEP, Mode.LINK, Mode.FREE):
            server.block(mode, times)
    server.block(Mode.LINK, Times())
    server.farewell()


def _processor_time(clients: ClientProcesses, times: Times) -> dict[Mode, NDArray[np.float64]]:
    """Processor seconds of all processes in each counted block, shape (blocks,) a mode."""
    total = {mode: np.array(times.cpu[mode]) for mode in Mode}
    for stamps in clients.stamps():
        spent: dict[int, list[float]] = {mode: [] for mode in Mode}
        for (mode, began), (_, ended) in pairwise(stamps):
            spent[mode].append(ended - began)
        spent[Mode.LINK].pop()  # the block before the farewell
        for mode in Mode:
            total[mode] = total[mode] + spent[mode][-len(times.cpu[mode]) :]
    return total


def _results(times: Times, cpu: dict[Mode, NDArray[np.float64]], steps: int) -> list[Result]:
    wall = {mode: np.array(times.wall[mode]) for mode in Mode}
    details = {}
    for mode in Mode:
        for name, seconds in (("cpu", cpu[mode]), ("wall", wall[mode])):
            key = f"{mode.name.lower()}_{name}_us_per_joint_step"
            details[key] = float(np.median(seconds)) / steps * 1e6
    link = cpu[Mode.LINK] / cpu[Mode.LOCKSTEP]
    free = wall[Mode.FREE] / wall[Mode.LOCKSTEP]
    waiting = np.array(times.waited) / wall[Mode.LOCKSTEP]
    more = cpu[Mode.LOCKSTEP] / cpu[Mode.FREE]
    return [
        Result.over("link_share", link, "share", LINK_HOW, TARGET, details),
        Result.over("lockstep_efficiency", free, "ratio", FREE_HOW),
        Result.over("waiting_share", waiting, "share", WAITING_HOW),
        Result.over("lockstep_cpu_vs_free", more, "ratio", CPU_HOW),
    ]
