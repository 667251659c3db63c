"""Where the time of a local joint step goes, part by part."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any

import numpy as np

from agent import single_threaded
from benchmarks.local import LocalRun, configured
from benchmarks.result import Result
from env.episode import EpisodeAccumulator
from env.local_env import LocalEnv
from training.aggregation.aggregator import Aggregator

HOW = "share of a local joint step, 3 robots and AP, by stopwatches around the calls"
NAMES = (
    "robots_learn",
    "robots_act",
    "robots_slice",
    "ap_learn",
    "ap_act",
    "world",
    "tally",
    "aggregation",
    "rest",
)


class Stopwatches:
    """Adds up the time spent in methods, by name."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(NAMES, 0.0)

    @contextmanager
    def around(self, methods: list[tuple[str, Any, str]]) -> Iterator[None]:
        """Times methods while the context lasts.

        Args:
            methods: (watch, object or class, method's name); no two may call each other.
        """
        for watch, owner, name in methods:
            setattr(owner, name, self._timed(watch, getattr(owner, name)))
        try:
            yield
        finally:
            for _, owner, name in methods:
                method = getattr(owner, name).__wrapped__
                if isinstance(owner, type):
                    setattr(owner, name, method)
                else:
                    delattr(owner, name)

    def _timed(self, watch: str, method: Callable[..., Any]) -> Callable[..., Any]:
        seconds, clock = self.seconds, time.perf_counter

        @wraps(method)
        def timed(*given: Any, **named: Any) -> Any:
            began = clock()
            try:
                return method(*given, **named)
            finally:
                seconds[watch] += clock() - began

        return timed


def parts(*, quick: bool = False) -> list[Result]:
    """Measures ``part_*``, the shares of a joint step."""
    single_threaded()
    steps, blocks = (50, 3) if quick else (250, 9)
    run = LocalRun(configured())
    run.play(150)
    shares: dict[str, list[float]] = {name: [] for name in NAMES}
    micros: list[float] = []
    for _ in range(blocks):
        seconds, whole = _block(run, steps)
        micros.append(whole / steps * 1e6)
        for name, value in seconds.items():
            shares[name].append(value / whole)
    details = {"us_per_joint_step": float(np.median(micros))}
    return [
        Result.over(f"part_{name}", np.array(values), "share", HOW, None, details)
        for name, values in shares.items()
    ]


def _block(run: LocalRun, steps: int) -> tuple[dict[str, float], float]:
    """Seconds of each part, and of all, in a block of joint steps."""
    watches = Stopwatches()
    methods: list[tuple[str, Any, str]] = [
        ("robots_learn", run.group.agents, "learn"),
        ("robots_act", run.group.agents, "act"),
        ("robots_slice", LocalEnv, "observe"),
        ("robots_slice", LocalEnv, "reward"),
        ("ap_learn", run.ap, "learn"),
        ("ap_act", run.ap, "act"),
        ("world", run.world, "step"),
        ("world", run.world, "local_observations"),
        ("world", run.world.observer, "global_observation"),
        ("tally", EpisodeAccumulator, "add"),
        ("tally", EpisodeAccumulator, "measures"),
        ("aggregation", Aggregator, "aggregate"),
    ]
    began = time.perf_counter()
    with watches.around(methods):
        run.play(steps)
    whole = time.perf_counter() - began
    known = sum(watches.seconds.values())
    return {**watches.seconds, "rest": whole - known}, whole
