"""What a robot costs in a building, from one room to 250: processor time and memory."""

from __future__ import annotations

import numpy as np
import psutil  # type: ignore[import-untyped]

from agent import single_threaded
from benchmarks.result import Result, micro, take_turns
from client_app.rooms import HostedRoom
from conf import compose
from conf.rooms import rooms_of

COUNTS = (1, 16, 64, 250)
ROBOTS = 4
COST = "processor time of a robot's tick in {} rooms of 4 robots, over that in one room"
MEMORY = "resident memory that a room of 4 robots adds to one process, mean of {}, replays filling"


def rooms(*, quick: bool = False) -> list[Result]:
    """Measures ``robot_in_rooms_*`` and ``room_mb``: rooms of ``experiment=building``, in turn."""
    single_threaded()
    counts, blocks = ((1, 4), 2) if quick else (COUNTS, 3)
    windows, warm = (1, 1) if quick else (2, 6)
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
    return [*results, Result.over("room_mb", each, "MB", MEMORY.format(len(hosted)))]
