"""What a robot costs in a building, from one room to 250, and what rooms abreast would save."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import psutil  # type: ignore[import-untyped]

from agent import DQN, NetworkShape, single_threaded
from benchmarks.engine import EPSILON
from benchmarks.env_step import Walk
from benchmarks.result import Result, Seconds, micro, take_turns
from client_app.rooms import HostedRoom
from conf import Config, ap_network, compose, robot_network
from conf.rooms import rooms_of
from env.scenario import Scenario
from env.seeding import Stream, stream

COUNTS = (1, 16, 64, 250)
ABREAST = 16
ROBOTS = 4
COST = "processor time of a robot's tick in {} rooms of 4 robots, over that in one room"
MEMORY = "resident memory that a room of 4 robots adds to one process, mean of {}, replays filling"
Steps = Callable[[int], None]

ABREAST_HOW = (
    "a bound: processor time of a tick of {0} rooms in turn, over the same less what one stack of"
    " all robots, one of all access points and one batch of {0} times the worlds save by themselves"
)


def rooms(*, quick: bool = False) -> list[Result]:
    """Measures ``robot_in_rooms_*`` and ``room_mb``: rooms of ``experiment=building``, in turn."""
    single_threaded()
    counts, blocks = ((1, 4), 2) if quick else (COUNTS, 3)
    windows, warm = (1, 4) if quick else (2, 6)  # they learn from the fourth window on
    config = compose(
        ["experiment=building", f"env.robots={ROBOTS}", f"rooms.count={counts[-1]}",
         "rooms.held_out=0"]
    )  # fmt: skip
    before = psutil.Process().memory_info().rss
    hosted = [HostedRoom(room.config(config)) for room in rooms_of(config, check=False)]
    model = np.zeros((2, hosted[0].parameters), np.float32)

    def play(count: int, windows: int) -> None:
        for room in hosted[:count]:
            room.play(windows, model)

    play(len(hosted), warm)
    added = psutil.Process().memory_info().rss - before
    taken = take_turns(
        {str(count): lambda n, count=count: play(count, n) for count in counts}, windows, blocks
    )
    alone, ticks = taken["1"], config.federation.every
    results = [
        Result.over(
            f"robot_in_rooms_{count}",
            taken[str(count)] / count / alone,
            "ratio",
            COST.format(count),
            details={"us_per_robot_tick": micro(taken[str(count)]) / (ticks * count * ROBOTS)},
        )
        for count in counts[1:]
    ]
    each = np.array([added / len(hosted) / 1e6])
    together = min(ABREAST, counts[-1])
    in_turn = taken[str(together)] / ticks
    return [
        *results,
        Result.over("room_mb", each, "MB", MEMORY.format(len(hosted))),
        abreast(rooms_of(config, check=False)[0].config(config), together, in_turn),
    ]


def abreast(config: Config, count: int, in_turn: Seconds) -> Result:
    """Bounds how much faster rooms would be if they were stepped and learned as one.

    Args:
        config: of a room.
        count: of rooms.
        in_turn: what a tick of so many takes, shape (blocks,).
    """
    scenario, worlds = Scenario.drawn(config.env, config.seed), config.train.worlds
    robot, ap = robot_network(config), ap_network(config)
    parts: dict[str, Callable[[int], Steps]] = {
        "robots": lambda rooms: Learning(config, robot, rooms * ROBOTS),
        "access points": lambda rooms: Learning(config, ap, rooms),
        "worlds": lambda rooms: Walk(scenario, rooms * worlds),
    }
    variants: dict[str, Steps] = {}
    for part, make in parts.items():
        variants[f"{part} in turn"] = in_line([make(1) for _ in range(count)])
        variants[f"{part} abreast"] = make(count)
    for warm in variants.values():
        warm(config.agent.learn_from // worlds + 1)
    taken = take_turns(variants, config.federation.every, len(in_turn))
    saved = {part: taken[f"{part} in turn"] - taken[f"{part} abreast"] for part in parts}
    shares: dict[str, float] = {}
    for part in parts:
        one, all_ = taken[f"{part} in turn"], taken[f"{part} abreast"]
        shares[f"{part}_share_of_tick"] = float(np.median(one / in_turn))
        shares[f"{part}_abreast_over_in_turn"] = float(np.median(all_ / one))
    bound = in_turn / (in_turn - sum(saved.values()))
    return Result.over(
        "rooms_abreast_at_most", bound, "ratio", ABREAST_HOW.format(count), details=shares
    )


def in_line(each: Sequence[Steps]) -> Steps:
    """Takes the same steps in one after the other."""

    def run(steps: int) -> None:
        for one in each:
            one(steps)

    return run


class Learning:
    """Agents that act and learn on made-up transitions."""

    def __init__(self, config: Config, shape: NetworkShape, agents: int) -> None:
        worlds, rng = config.train.worlds, np.random.default_rng(0)
        streams = [stream(0, Stream.ROBOT, k) for k in range(agents)]
        self._agents = DQN(shape, config.agent, config.agent.discount.robot, streams, worlds=worlds)
        self._agents.load(shape.initial_pair(stream(0, Stream.WEIGHTS)))
        self._seen = rng.normal(size=(agents * worlds, shape.inputs)).astype(np.float32)
        self._reward = rng.normal(size=agents * worlds)
        self._active = np.ones(agents * worlds, dtype=bool)

    def __call__(self, steps: int) -> None:
        """Takes joint steps."""
        seen, active, ended = self._seen, self._active, ~self._active
        for _ in range(steps):
            moves = self._agents.act(seen, EPSILON, active)
            self._agents.learn(seen, moves, self._reward, seen, ended, active)
