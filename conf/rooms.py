"""The rooms of a building: what the group ``rooms`` says, room by room.

A room is described by what of it differs from the run's configuration, so that whoever hosts it
makes its own configuration from the run's, and needs no file of a floor plan.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from conf.checks import problems
from conf.errors import ConfigError
from conf.networks import ap_network, robot_network
from conf.schema import Config, RoomsConfig
from env.checks import planned_config, replaced
from env.config import EnvConfig
from env.geometry import floor_plans
from env.seeding import Stream, derived_seed

ENDLESS = 10**9
"""Episodes of a room: the building ends its rooms."""

RANDOM = "random"
"""Of ``rooms.plans``: a floor from each room's own seed."""


@dataclass(frozen=True)
class Room:
    """One room of a building.

    Attributes:
        index: from 0; rooms that are held out are counted by themselves.
        held_out: whether nobody trains in it.
        seed: of its radio map, starts, destinations and agents.
        env: fields of ``EnvConfig`` that differ from the run's, nested.
    """

    index: int
    held_out: bool
    seed: int
    env: Mapping[str, Any] = field(hash=False)

    @property
    def name(self) -> str:
        """Its folder's name."""
        return room_name(self.index, held_out=self.held_out)

    def config(self, run: Config) -> Config:
        """The room as a run of its own: one room, with the building's agents and learners."""
        return replace(
            run,
            seed=self.seed,
            env=replaced(run.env, self.env, "env"),
            train=replace(run.train, episodes=ENDLESS, max_ticks=None),
            federation=replace(run.federation, clients=None, on_loss="wait"),
            rooms=RoomsConfig(),
        )


def room_name(index: int, *, held_out: bool = False) -> str:
    """The name of a room's folders."""
    return f"{'held-out-' if held_out else ''}{index:04d}"


def rooms_of(config: Config, *, check: bool = True) -> list[Room]:
    """All rooms of a building, those that are held out last.

    The same seed gives the same rooms, and a further room changes none before it.

    Args:
        config: a building's, free of other problems.
        check: whether to look at each room, which takes most of the time.

    Raises:
        ConfigError: a room is none that the program can play, or robots of different rooms have
            networks of different sizes.
    """
    rooms = [_drawn(config, index, held_out=False) for index in range(config.rooms.count)]
    rooms += [_drawn(config, index, held_out=True) for index in range(config.rooms.held_out)]
    if config.env.state.way == "auto":  # all robots see alike, or none could take another's network
        solid = any(replaced(config.env, room.env, "env").walls.block_motion for room in rooms)
        seen = {"way": "on" if solid else "off"}
        rooms = [replace(room, env={**room.env, "state": seen}) for room in rooms]
    if check:
        _check(config, rooms)
    return rooms


def to_json(rooms: Sequence[Room]) -> str:
    """Rooms as text, a line each."""
    return "[" + ",\n".join(json.dumps(asdict(room)) for room in rooms) + "]\n"


def from_json(text: str) -> list[Room]:
    """The rooms that ``to_json`` wrote.

    Raises:
        ValueError: it is none of it.
    """
    try:
        rooms = [Room(**room) for room in json.loads(text)]
    except TypeError as error:
        raise ValueError(str(error)) from error
    for room in rooms:
        for item in fields(Room):
            value = getattr(room, item.name)
            if type(value) is not _KINDS[item.name] or (type(value) is int and value < 0):
                raise ValueError(f"a room's {item.name} is {value!r}")
    return rooms


_KINDS = {"index": int, "held_out": bool, "seed": int, "env": dict}


def _drawn(config: Config, index: int, *, held_out: bool) -> Room:
    """A room by itself."""
    name = Stream.HELD_OUT_ROOM if held_out else Stream.ROOM
    seed = derived_seed(config.seed, name, index)
    rooms, env = config.rooms, config.env
    changes: dict[str, Any] = {"map_seed": seed}
    if rooms.robots:
        changes["robots"] = rooms.robots[index % len(rooms.robots)]
    if rooms.plans:
        plan = str(rooms.plans[index % len(rooms.plans)])
        plan = f"{RANDOM}:{seed}" if plan == RANDOM else plan
        changes |= {"plan": plan, **_geometry(env, plan)}
    return Room(index, held_out, seed, changes)


def _geometry(env: EnvConfig, plan: str) -> dict[str, dict[str, Any]]:
    """What a plan sets in the place of the run's own, but for what a user has set above that.

    Raises:
        ConfigError: there is no such plan, or it sets what it may not.
    """
    try:
        before, after = planned_config(env.plan), planned_config(plan)
    except ValueError as error:
        raise ConfigError(f"rooms.plans: {error}.") from error
    changes: dict[str, dict[str, Any]] = {}
    for key in floor_plans.KEYS:
        group, name = key.split(".")
        mine, old, new = (getattr(getattr(each, group), name) for each in (env, before, after))
        if mine == old and mine != new:
            changes.setdefault(group, {})[name] = new
    return changes


def _check(run: Config, rooms: Sequence[Room]) -> None:
    """Raises a ``ConfigError`` that names the first room with which something is wrong."""
    first = rooms[0].config(run)
    for room in rooms:
        config = room.config(run)
        if found := problems(config):
            which = f"room {room.name} ({config.env.plan}, seed {room.seed})"
            key, value, say = found[0]
            raise ConfigError(f"{which}: {key}={value}: allowed is {say}.")
        if robot_network(config) != robot_network(first):
            say = "such that robots of all rooms see equally much, as they share a network"
            raise ConfigError.of([("env.state.others", run.env.state.others, say)])
        averaged = run.rooms.access_points == "mean" and run.scheme.phase == "learned"
        if averaged and ap_network(config) != ap_network(first):
            say = "own, where rooms have different numbers of robots"
            raise ConfigError.of([("rooms.access_points", "mean", say)])
