"""The rules of the group ``env``: what depends on more than one field."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from env import plugins, validate
from env.arrays import Bools, Floats, Ints
from env.config import MAX_CELLS, MAX_PAIRS, MAX_PHASE_ACTIONS, EnvConfig, RoomConfig, phase_actions
from env.geometry.distances import distance_m
from env.geometry.floor import Floor
from env.mdp import lateness
from env.radio import channel_file, mounting
from env.validate import Problem


def problems(config: EnvConfig) -> list[Problem]:
    """Lists what is wrong with a configuration: keys, their values, and what is allowed."""
    return validate.problems(config, RULES, "env.")


def _room_problems(config: EnvConfig) -> Iterator[Problem]:
    room = config.room
    for key, side in (("env.room.width_m", room.width_m), ("env.room.depth_m", room.depth_m)):
        cells = side / room.cell_m
        if abs(cells - round(cells)) > 1e-9 or round(cells) < 2:
            yield key, side, f"a multiple of env.room.cell_m={room.cell_m}, at least two"
    if room.width_m * room.depth_m / room.cell_m**2 > MAX_CELLS:
        yield "env.room.cell_m", room.cell_m, f"a side with at most {MAX_CELLS} cells"
    for key, position in (
        ("env.ap.position_m", config.ap.position_m),
        ("env.ris.position_m", config.ris.position_m),
    ):
        if not _numbers(position, 3) or not _inside(room, position, closed=True) or position[2] < 0:
            yield key, position, "[x, y, z] in m inside the room or on its edge"
    for segment in config.walls.segments:
        if not _numbers(segment, 4) or segment[:2] == segment[2:]:
            yield "env.walls.segments", segment, "segments [x0, y0, x1, y1] in m"


def _destination_problems(config: EnvConfig) -> Iterator[Problem]:
    key, room, seen = "env.tasks.destinations_m", config.room, set()
    for place in config.tasks.destinations_m:
        if not _numbers(place, 2) or not _inside(room, place):
            yield key, place, _in_the_room(room)
        elif (cell := _cell(room, place)) in seen:
            yield key, place, "destinations in cells of their own"
        else:
            seen.add(cell)


def _start_problems(config: EnvConfig) -> Iterator[Problem]:
    """Whether some cell is far enough from each destination; a drawn one may lie in the middle."""
    if config.tasks.start == "fixed":
        return
    room, tasks = config.room, config.tasks
    destinations, number = _given_destinations(config)
    if number > len(destinations):
        destinations = [*destinations, [room.width_m / 2, room.depth_m / 2]]
    half = room.cell_m / 2
    reach = math.inf
    for x, y in destinations:
        cell_x, cell_y = (math.floor(v / room.cell_m) * room.cell_m + half for v in (x, y))
        far_x = max(cell_x - half, room.width_m - half - cell_x)
        far_y = max(cell_y - half, room.depth_m - half - cell_y)
        reach = min(reach, math.hypot(far_x, far_y))
    if tasks.start_distance_m > reach:
        allowed = f"at most {reach:.4g}, since no cell is farther from one of the destinations"
        yield "env.tasks.start_distance_m", tasks.start_distance_m, allowed


def _given_destinations(config: EnvConfig) -> tuple[list[Any], int]:
    """The destinations that are given, and how many there are in all."""
    tasks = config.tasks
    number = 1 if tasks.destination == "common" else config.robots
    return ([] if tasks.destination == "random" else tasks.destinations_m[:number]), number


def _fixed_start_problems(config: EnvConfig) -> Iterator[Problem]:
    if config.tasks.start != "fixed":
        return
    key, room, starts = "env.tasks.starts_m", config.room, config.tasks.starts_m
    off = [place for place in starts if not _numbers(place, 2) or not _inside(room, place)]
    yield from ((key, place, _in_the_room(room)) for place in off)
    if off:
        return
    if len(starts) < config.robots:
        say = f"at least env.robots={config.robots} places with env.tasks.start=fixed"
        yield key, starts, say
        return
    cells = [_cell(room, start) for start in starts[: config.robots]]
    if config.collisions == "block" and len({*cells}) < len(cells):
        yield key, starts, "places in cells of their own with env.collisions=block"
        return
    goals, _ = _given_destinations(config)
    if config.tasks.destination == "common":
        goals = goals * config.robots
    for start, goal in zip(starts, goals, strict=False):
        if _cell(room, start) == _cell(room, goal):
            yield key, start, "places off the cell of the robot's destination"


def _way_problems(config: EnvConfig) -> Iterator[Problem]:
    """With solid walls, whether given places are cut off, and whether starts are far enough."""
    if not config.walls.block_motion:
        return
    floor, tasks = Floor.from_config(config), config.tasks
    drivable, (goals, number) = floor.drivable(), _given_destinations(config)
    places = [("env.tasks.destinations_m", goal) for goal in goals]
    if tasks.start == "fixed":
        places += [("env.tasks.starts_m", start) for start in tasks.starts_m[: config.robots]]
    allowed = "places that the rest of the floor can reach with env.walls.block_motion=true"
    cut_off = [(key, at) for key, at in places if not drivable[floor.cell_at(np.asarray(at))]]
    yield from ((key, place, allowed) for key, place in cut_off)
    if cut_off or tasks.start == "fixed":
        return
    cells = floor.cell_at(np.asarray(goals, dtype=np.float64).reshape(-1, 2))
    if number > len(goals):  # further ones are drawn, from all of it
        cells = np.flatnonzero(drivable)
    reach = float(_farthest_m(floor, drivable, cells).min())
    if tasks.start_distance_m > reach:
        say = f"at most {reach:.4g}, since no cell with a way to a destination is farther from it"
        yield "env.tasks.start_distance_m", tasks.start_distance_m, say


def _farthest_m(floor: Floor, drivable: Bools, cells: Ints) -> Floats:
    """From each cell to the farthest drivable one, which is the first or the last of its row."""
    rows = drivable.reshape(floor.rows, floor.columns)
    first, last = rows.argmax(axis=1), floor.columns - 1 - rows[:, ::-1].argmax(axis=1)
    ends = np.concatenate([first, last]) + np.tile(np.arange(floor.rows), 2) * floor.columns
    centres, far_m = floor.centres(), np.zeros(len(cells))
    for end in ends[np.tile(rows.any(axis=1), 2)]:
        far_m = np.maximum(far_m, distance_m(centres[cells], centres[end]))
    return far_m


def _cell(room: RoomConfig, position: Sequence[float]) -> tuple[int, ...]:
    return tuple(math.floor(x / room.cell_m) for x in position)


def _numbers(value: Any, count: int) -> bool:
    return (
        isinstance(value, list)
        and len(value) == count
        and all(isinstance(x, int | float) and math.isfinite(x) for x in value)
    )


def _in_the_room(room: RoomConfig) -> str:
    return f"[x, y] inside the room of {room.width_m:g} m x {room.depth_m:g} m"


def _inside(room: RoomConfig, position: Sequence[float], *, closed: bool = False) -> bool:
    x, y = position[:2]
    if closed:
        return 0 <= x <= room.width_m and 0 <= y <= room.depth_m
    return 0 <= x < room.width_m and 0 <= y < room.depth_m


def _combination_problems(config: EnvConfig) -> Iterator[Problem]:
    ris, power, credit = config.ris, config.power, config.reward.credit
    most_bits = MAX_PHASE_ACTIONS.bit_length() - 1
    if ris.side**2 % ris.subsurfaces:
        allowed = f"a divisor of the {ris.side**2} elements that env.ris.side={ris.side} gives"
        yield "env.ris.subsurfaces", ris.subsurfaces, allowed
    elif ris.bits * ris.subsurfaces > most_bits:
        allowed = (
            f"at most {MAX_PHASE_ACTIONS} phase settings: with env.ris.bits={ris.bits}"
            f" that is {most_bits // ris.bits} sub-surfaces or fewer"
        )
        yield "env.ris.subsurfaces", ris.subsurfaces, allowed
    if config.access != "noma":
        return
    if power.resolve == "project" and power.levels < config.robots:
        allowed = (
            f"at least env.robots={config.robots} with env.power.resolve=project, since NOMA gives"
            " each robot a level of its own (residual and zero allow fewer)"
        )
        yield "env.power.levels", power.levels, allowed
    if credit == "difference" and power.resolve != "project":
        allowed = (
            f"rate or team with env.power.resolve={power.resolve}, whose rates depend on what fails"
            " in the slot"
        )
        yield "env.reward.credit", credit, allowed


def _pair_problems(config: EnvConfig) -> Iterator[Problem]:
    """Whether the distances from every element to every cell are too many to work out."""
    ris, cells = config.ris, Floor.from_config(config).cells
    if ris.response in ("far", "near") and ris.side**2 * cells > MAX_PAIRS:
        allowed = (
            f"at most {math.isqrt(MAX_PAIRS // cells)} with env.ris.response={ris.response} and"
            f" {cells} cells, since elements times cells may be {MAX_PAIRS} at most"
        )
        yield "env.ris.side", ris.side, allowed


def _codebook_problems(config: EnvConfig) -> Iterator[Problem]:
    """Whether beams can be made: from places of elements, for sectors that have cells."""
    ris, say = config.ris, "with env.ris.action=codebook"
    if ris.action != "codebook":
        return
    floor = Floor.from_config(config)
    cells = floor.columns, floor.rows
    shape = len(ris.sectors) == 2 and all(isinstance(number, int) for number in ris.sectors)
    if ris.response not in ("far", "near"):
        allowed = f"far or near {say}, since a beam needs elements with places"
        yield "env.ris.response", ris.response, allowed
    elif config.channel.model != "indoor_hotspot":
        allowed = f"indoor_hotspot {say}: another model gives no channel of each element"
        yield "env.channel.model", config.channel.model, allowed
    elif ris.subsurfaces != 1:
        yield "env.ris.subsurfaces", ris.subsurfaces, f"1 {say}, which sets every element by itself"
    elif ris.side == 0:
        yield "env.ris.side", ris.side, f"at least 1 {say}"
    elif not shape or not all(1 <= n <= most for n, most in zip(ris.sectors, cells, strict=True)):
        allowed = f"[columns, rows] of 1 to {cells[0]} and 1 to {cells[1]}, the cells there are"
        yield "env.ris.sectors", ris.sectors, allowed
    elif phase_actions(ris) > MAX_PHASE_ACTIONS:
        allowed = f"at most {MAX_PHASE_ACTIONS} sectors, each of which is an action of the AP"
        yield "env.ris.sectors", ris.sectors, allowed


RULES = (
    plugins.problems,
    channel_file.key_problems,
    _room_problems,
    mounting.problems,
    _destination_problems,
    _start_problems,
    _fixed_start_problems,
    _way_problems,
    lateness.given_problems,
    _combination_problems,
    _pair_problems,
    _codebook_problems,
)
"""Each counts on those before it."""
