"""What is allowed in the group ``rooms``, of a configuration as a whole; see ``conf.rooms``."""

from __future__ import annotations

from collections.abc import Iterator

from conf import strategy_checks
from conf.schema import Config, changed, has_rooms, taking_part
from env.config import MAX_ROBOTS
from env.validate import Problem


def rules(config: Config) -> Iterator[Problem]:
    """What is wrong with a building, of a configuration otherwise right."""
    rooms, on_loss = config.rooms, config.federation.on_loss
    if on_loss == "miss" and not (has_rooms(config) and config.runtime.name == "deployment"):
        say = "wait or abort here: rooms of a building in a deployment alone can miss a round"
        yield "federation.on_loss", on_loss, say
    if not has_rooms(config):
        say = "not set with rooms.count=1 and rooms.held_out=0: only buildings read it"
        for key, value, _ in changed(rooms):
            yield f"rooms.{key}", value, say
        return
    if config.scheme.agents != "federated" or config.scheme.robots != "learned":
        who = f"scheme.agents={config.scheme.agents} and scheme.robots={config.scheme.robots}"
        yield "rooms.count", rooms.count, f"1 with {who}: rooms share what robots learn"
    if config.strategy.name in ("none", "gossip"):
        say = "any other in a building: a room hands on one network"
        yield "strategy.name", config.strategy.name, say
    for key, dp in (("strategy", config.strategy.dp), ("rooms.strategy", rooms.strategy.dp)):
        if dp.name != "none":
            say = "none in a building: privacy is accounted for one room"
            yield f"{key}.dp.name", dp.name, say
    if config.federation.windows_per_round is not None:
        say = "null in a building: its rounds are of rooms.every windows"
        yield "federation.windows_per_round", config.federation.windows_per_round, say
    if any(not 1 <= robots <= MAX_ROBOTS for robots in rooms.robots):
        yield "rooms.robots", rooms.robots, f"a list of numbers from 1 to {MAX_ROBOTS}"
    if any(not isinstance(plan, str) for plan in rooms.plans):
        yield "rooms.plans", rooms.plans, "a list of names and paths of floor plans"
    if rooms.strategy.name == "fedprox":
        say = "any other across rooms: the proximal term is that of strategy, inside a room"
        yield "rooms.strategy.name", "fedprox", say
    if rooms.strategy.name in strategy_checks.FULL_NUMBER and on_loss == "miss":
        say = f"wait or abort with {rooms.strategy.name}, which needs all"
        yield "federation.on_loss", "miss", say
    count = taking_part(config)
    counted = "rooms.count" if count == rooms.count else "rooms.fraction * rooms.count"
    for key, value, say in strategy_checks.problems(rooms.strategy, count, counted):
        yield f"rooms.{key}", value, say
    if rooms.strategy.name == "none":
        yield "rooms.strategy.name", "none", "any other: rooms that share nothing are runs"
    elif rooms.strategy.name in ("gossip", "visits"):
        say = "any other across rooms: it is of robots in one room"
        yield "rooms.strategy.name", rooms.strategy.name, say
