"""How fast lockstep can be at all: a bound on its efficiency from what a tick consists of.

A tick in lockstep is a serial part at the server (world, records), one exchange with K processes,
and the robots' work beside the access point's. Each is measured by itself: the parts as processor
time in one process, the exchange over bare sockets with processes that do nothing else. On C cores

    lockstep >= serial + exchange + max(largest part, sum of the parts / C)
    free     >= max(largest process, sum of all work / C)

where the second holds for the same work without any message; no schedule is shorter, preemptive or
not (McNaughton, Scheduling with Deadlines and Loss Functions, 1959). A processor that loses its
caches between ticks, and a process that wakes late, only add to the first.

    lockstep_bound    = free / lockstep, at best
    lockstep_of_bound = measured lockstep_efficiency / lockstep_bound
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent import single_threaded
from benchmarks.clients import connected_clients
from benchmarks.deployment import measured_efficiency
from benchmarks.local import ServerSide, configured, initial_weights
from benchmarks.overheads import Exchanges
from benchmarks.result import Result, micro, take_turns
from benchmarks.sockets import echoing
from client_app.robots import RobotGroup
from conf import Config
from lockstep import Expect, InProcessFleet, Robots, Step
from lockstep.messages import PLAIN
from lockstep.wire_format import actions_size, step_size

BOUND_HOW = (
    "wall time of free work over that of lockstep, at best, {} robots in a process each, on the {}"
    " cores of this machine: from the parts of a tick and an exchange over bare sockets"
)
OF_BOUND_HOW = "lockstep_efficiency as measured over lockstep_bound, K = {}"
WARM_UP = 150


@dataclass(frozen=True)
class Tick:
    """What a tick consists of, in s.

    Attributes:
        serial: at the server, while every robot waits.
        ap: at the server, beside the robots.
        robots: each robot's, shape (K,).
        exchange: a frame to each robot's process and one back.
    """

    serial: float
    ap: float
    robots: NDArray[np.float64]
    exchange: float

    def bound(self, cores: int) -> float:
        """The largest lockstep efficiency on so many cores."""
        server = self.serial + self.ap
        free = shortest([server, *self.robots], cores)
        return free / (self.serial + self.exchange + shortest([self.ap, *self.robots], cores))


def shortest(work: Sequence[float], cores: int) -> float:
    """The shortest time in which pieces of work are done that may move between cores."""
    return max(max(work), sum(work) / cores)


class Timed:
    """A robot's handler that notes the processor time that it takes."""

    def __init__(self, group: RobotGroup) -> None:
        self.robots, self._group = group.robots, group
        self.spent_s = 0.0
        self.upload, self.download = group.upload, group.download

    def step(self, step: Step) -> NDArray[np.int32] | None:
        """See ``Robots.step``."""
        began = time.process_time()
        given = self._group.step(step)
        self.spent_s += time.process_time() - began
        return given


class Parted(InProcessFleet):
    """All robots in this process, each by itself; notes what the server does between the calls.

    Attributes:
        spent_s: processor time: ``serial``, from the robots' actions to the next step, and of
            aggregations; ``ap``, from a step to where its answers are asked for.
    """

    def __init__(self, handlers: Sequence[tuple[tuple[int, ...], Robots]]) -> None:
        super().__init__(handlers)
        self.spent_s = {"serial": 0.0, "ap": 0.0}
        self._since: float | None = None

    def send_step(self, tick: int, window: int, expect: Expect, updates: np.ndarray) -> None:
        """See ``Fleet.send_step``."""
        self._note("serial")
        super().send_step(tick, window, expect, updates)
        self._since = time.process_time()

    def actions(self, tick: int) -> NDArray[np.int32]:
        """See ``Fleet.actions``."""
        self._note("ap")
        given = super().actions(tick)
        self._since = time.process_time()
        return given

    def upload(self, window: int) -> NDArray[np.float32]:
        """See ``Fleet.upload``."""
        self._note("ap")
        given = super().upload(window)
        self._since = time.process_time()
        return given

    def download(self, window: int, weights: NDArray[np.float32]) -> None:
        """See ``Fleet.download``."""
        self._note("serial")
        super().download(window, weights)
        self._since = time.process_time()

    def _note(self, part: str) -> None:
        if self._since is not None:
            self.spent_s[part] += time.process_time() - self._since


class PartedRun(ServerSide):
    """A run in this process, whose parts are timed."""

    def __init__(self, config: Config) -> None:
        groups = [RobotGroup(config, (robot,)) for robot in range(config.env.robots)]
        for group in groups:
            group.download(0, initial_weights(config))
        self._handlers = [Timed(group) for group in groups]
        super().__init__(config, self._new_fleet())

    def parts(self, steps: int) -> tuple[float, float, NDArray[np.float64]]:
        """Plays a stretch; processor seconds a tick of ``serial``, ``ap`` and each robot."""
        before = self._spent_s()
        self._fleet = fleet = self._new_fleet()  # each stretch is a conversation of its own
        self.play(steps)
        robots = (self._spent_s() - before) / steps
        return fleet.spent_s["serial"] / steps, fleet.spent_s["ap"] / steps, robots

    def _new_fleet(self) -> Parted:
        return Parted([(handler.robots, handler) for handler in self._handlers])

    def _spent_s(self) -> NDArray[np.float64]:
        return np.array([handler.spent_s for handler in self._handlers])


def exchanges(config: Config, steps: int, blocks: int) -> dict[str, NDArray[np.float64]]:
    """Wall seconds of an exchange with idle processes, ``bare`` or over the ``link``, (blocks,)."""
    sizes = step_size(1, PLAIN), actions_size(1, PLAIN)
    with echoing(config.env.robots, sizes) as bare, connected_clients(config) as clients:
        link = Exchanges(clients.link, config.env.robots)
        variants: dict[str, Callable[[int], object]] = {"bare": bare, "link": link}
        for exchange in variants.values():
            exchange(steps)
        taken = take_turns(variants, steps, blocks, time.perf_counter)
        link.farewell()
    return taken


def lockstep(*, quick: bool = False) -> list[Result]:
    """Measures ``lockstep_bound_*`` and ``lockstep_of_bound_*`` for one robot and for three."""
    single_threaded()
    return [result for robots in (1, 3) for result in _against_bound(robots, quick)]


def _against_bound(robots: int, quick: bool) -> list[Result]:
    config = configured(f"env.robots={robots}")
    steps, blocks = (50, 2) if quick else (300, 9)
    run, taken = PartedRun(config), exchanges(config, steps, blocks)
    run.parts(WARM_UP)
    quickest = float(taken["bare"].min())  # a bound: what others do on this machine is no reason
    ticks = [Tick(*run.parts(steps), quickest) for _ in range(blocks)]
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    bounds = np.array([tick.bound(cores) for tick in ticks])
    enough = np.array([tick.bound(robots + 1) for tick in ticks])
    efficiency = measured_efficiency(config, quick=quick)
    details = {
        "cores": float(cores),
        "bound_with_a_core_each": float(np.median(enough)),
        "measured_efficiency": float(np.median(efficiency)),
        "serial_us": micro(np.array([tick.serial for tick in ticks])),
        "ap_us": micro(np.array([tick.ap for tick in ticks])),
        "robot_us": micro(np.array([tick.robots for tick in ticks])),
        "exchange_us": micro(taken["bare"]),
        "exchange_with_frames_us": micro(taken["link"]),
    }
    how = BOUND_HOW.format(robots, cores)
    share = efficiency / np.median(bounds)
    return [
        Result.over(f"lockstep_bound_k{robots}", bounds, "ratio", how, None, details),
        Result.over(f"lockstep_of_bound_k{robots}", share, "share", OF_BOUND_HOW.format(robots)),
    ]
