"""The schema of the group ``env``: every physical constant and every switch of the model.

Values are the defaults of ``docs/assumptions.md``; "Table I" is the paper's table of parameters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

Problem = tuple[str, Any, str]
"""A key, the value it has, and what is allowed there."""


@dataclass(frozen=True)
class RoomConfig:
    """The floor: a rectangle with a corner at the origin, cut into square cells."""

    width_m: float = 30.0
    depth_m: float = 30.0
    cell_m: float = 0.5  # Delta_S, Table I


@dataclass(frozen=True)
class WallsConfig:
    """Full-height walls, each ``[x0, y0, x1, y1]`` in m. They shade radio links."""

    segments: list[Any] = field(default_factory=lambda: [[0.0, 15.0, 21.0, 15.0]])


@dataclass(frozen=True)
class AccessPointConfig:
    """The access point."""

    position_m: list[float] = field(default_factory=lambda: [15.0, 30.0, 2.0])


@dataclass(frozen=True)
class RisConfig:
    """The reconfigurable intelligent surface: M = side^2 elements in N sub-surfaces."""

    position_m: list[float] = field(default_factory=lambda: [30.0, 7.5, 2.0])
    side: int = 30  # M_R; 0 is no RIS
    subsurfaces: int = 1  # N
    bits: int = 2  # b; N_R = 2^b phases
    response: str = "coherent"
    spacing: float = 0.5  # of neighbouring elements, in wavelengths
    axis: str = "y"  # the panel's horizontal direction
    action: str = "phases"  # what the AP chooses among
    sectors: list[int] = field(default_factory=lambda: [6, 6])  # of the codebook, along x and y


@dataclass(frozen=True)
class MotionConfig:
    """How robots move and what moving costs."""

    speed_mps: float = 0.5  # v, Table I
    energy_per_m_j: float = 7.4  # E_1, Table I
    idle_power_w: float = 0.29  # E_2, Table I
    antenna_height_m: float = 1.0
    max_slots: int = 150  # T_max = T_e


@dataclass(frozen=True)
class TasksConfig:
    """Where robots start and where they are going.

    ``destination=fixed``: the first K of ``destinations_m``; where there are fewer, further ones
    are drawn, at least ``destination_spacing_m`` apart from all others. ``random``: all K are
    drawn so, once a run. ``common``: all robots go to the first one.

    ``start=random``: anywhere at least ``start_distance_m`` from the robot's destination, anew in
    each episode. ``fixed``: at the first K of ``starts_m``.
    """

    destination: str = "fixed"
    destinations_m: list[Any] = field(
        default_factory=lambda: [[27.25, 12.25], [4.25, 10.25], [22.25, 2.25], [26.25, 24.25]]
    )
    destination_spacing_m: float = 5.0
    start: str = "random"
    starts_m: list[Any] = field(default_factory=list)
    start_distance_m: float = 10.0


@dataclass(frozen=True)
class ChannelConfig:
    """Path loss and fading of 3GPP TR 38.901, indoor hotspot."""

    frequency_ghz: float = 2.4
    rician_k_db: float = 7.0
    fading: str = "static"
    los_phase: str = "zero"


@dataclass(frozen=True)
class NoiseConfig:
    """Thermal noise: sigma^2 = density times bandwidth."""

    density_dbm_per_hz: float = -100.0  # N_0
    bandwidth_hz: float = 1.0


@dataclass(frozen=True)
class PowerConfig:
    """Downlink power: levels P_max / 2^l for l = 1..levels."""

    levels: int = 6  # N_P
    max_dbm: float = 20.0  # P_max
    resolve: str = "project"
    sic_margin: float = 10.0  # rho_min in multiples of sigma^2


@dataclass(frozen=True)
class OmaConfig:
    """Orthogonal access, Baseline 2: equal parts of band and power."""

    share: str = "fixed"


@dataclass(frozen=True)
class QoeConfig:
    """Quality of experience, Baseline 3: eta_k = C_1 lg(R_k) + C_2."""

    scale: float = 1.0  # C_1
    offset: float = 0.0  # C_2
    floor: float = 0.01  # least R_k in bit/s/Hz


@dataclass(frozen=True)
class StateConfig:
    """What agents observe beyond the paper's position and direct channel."""

    destination: str = "offset"


@dataclass(frozen=True)
class RewardConfig:
    """Weights of the robots' and the access point's rewards."""

    rate: float = 0.05  # phi
    guidance: float = 3.0  # psi
    time: float = -1.0  # R_time, Table I
    goal: float = 100.0  # R_goal, Table I
    sum_rate: float = 0.1  # tau_1, Table I
    global_offset: float = 0.0


@dataclass(frozen=True)
class EnvConfig:
    """The world of one run."""

    robots: int = 3  # K
    map_seed: int = 0
    access: str = "noma"
    metric: str = "qos"
    room: RoomConfig = field(default_factory=RoomConfig)
    walls: WallsConfig = field(default_factory=WallsConfig)
    ap: AccessPointConfig = field(default_factory=AccessPointConfig)
    ris: RisConfig = field(default_factory=RisConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    tasks: TasksConfig = field(default_factory=TasksConfig)
    channel: ChannelConfig = field(default_factory=ChannelConfig)
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    power: PowerConfig = field(default_factory=PowerConfig)
    oma: OmaConfig = field(default_factory=OmaConfig)
    qoe: QoeConfig = field(default_factory=QoeConfig)
    state: StateConfig = field(default_factory=StateConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)


MAX_ROBOTS = 64
MAX_POWER_LEVELS = 48  # sums of the levels stay exact in float64
MAX_PHASE_ACTIONS = 4096
MAX_CELLS = 250_000
MAX_PAIRS = 10**9  # of elements and cells whose distances the far and near field need
CHOICES: dict[str, tuple[str, ...]] = {
    "env.access": ("noma", "oma"),
    "env.metric": ("qos", "qoe"),
    "env.oma.share": ("fixed", "reallocate"),
    "env.tasks.destination": ("fixed", "random", "common"),
    "env.tasks.start": ("random", "fixed"),
    "env.ris.response": ("coherent", "far", "near", "rayleigh"),
    "env.ris.axis": ("x", "y"),
    "env.ris.action": ("phases", "codebook"),
    "env.channel.fading": ("static", "none", "slot"),
    "env.channel.los_phase": ("zero", "distance"),
    "env.power.resolve": ("project", "residual", "zero"),
    "env.state.destination": ("offset", "none"),
}
POSITIVE = (
    "env.room.cell_m",
    "env.motion.speed_mps",
    "env.motion.idle_power_w",
    "env.channel.frequency_ghz",
    "env.noise.bandwidth_hz",
    "env.qoe.scale",
    "env.qoe.floor",
)
NOT_NEGATIVE = (
    "env.map_seed",
    "env.motion.energy_per_m_j",
    "env.motion.antenna_height_m",
    "env.tasks.destination_spacing_m",
    "env.tasks.start_distance_m",
    "env.power.sic_margin",
)
BETWEEN: dict[str, tuple[float, float]] = {
    "env.robots": (1, MAX_ROBOTS),
    "env.ris.side": (0, 256),
    "env.ris.bits": (1, 12),
    "env.ris.subsurfaces": (1, 65536),
    "env.ris.spacing": (0.01, 100),
    "env.power.levels": (1, MAX_POWER_LEVELS),
    "env.power.max_dbm": (-60, 60),
    "env.motion.max_slots": (1, 1_000_000),
    "env.room.width_m": (1, 1000),
    "env.room.depth_m": (1, 1000),
}


def problems(config: EnvConfig) -> list[Problem]:
    """Lists what is wrong with a configuration: keys, their values, and what is allowed."""
    found = [*_choice_problems(config), *(_finite_problems(config) or _range_problems(config))]
    if not found:
        found += [*_geometry_problems(config), *_combination_problems(config)]
        found += _pair_problems(config)
        if config.ris.action == "codebook":
            found += _codebook_problems(config)
    return found


def _value(config: EnvConfig, key: str) -> Any:
    value: Any = config
    for name in key.split(".")[1:]:
        value = getattr(value, name)
    return value


def _choice_problems(config: EnvConfig) -> list[Problem]:
    return [
        (key, _value(config, key), f"one of {', '.join(allowed)}")
        for key, allowed in CHOICES.items()
        if _value(config, key) not in allowed
    ]


def _finite_problems(values: Any, above: str = "env") -> list[Problem]:
    found: list[Problem] = []
    for item in fields(values):
        key, value = f"{above}.{item.name}", getattr(values, item.name)
        if is_dataclass(value):
            found += _finite_problems(value, key)
        elif isinstance(value, float) and not math.isfinite(value):
            found.append((key, value, "a finite number"))
    return found


def _range_problems(config: EnvConfig) -> list[Problem]:
    found: list[Problem] = []
    for key in POSITIVE:
        if not _value(config, key) > 0:
            found.append((key, _value(config, key), "a number above 0"))
    for key in NOT_NEGATIVE:
        if not _value(config, key) >= 0:
            found.append((key, _value(config, key), "a number of at least 0"))
    for key, (low, high) in BETWEEN.items():
        if not low <= _value(config, key) <= high:
            found.append((key, _value(config, key), f"a number from {low:g} to {high:g}"))
    return found


def _geometry_problems(config: EnvConfig) -> list[Problem]:
    room = config.room
    found: list[Problem] = []
    for key, side in (("env.room.width_m", room.width_m), ("env.room.depth_m", room.depth_m)):
        cells = side / room.cell_m
        if abs(cells - round(cells)) > 1e-9 or round(cells) < 2:
            found.append((key, side, f"a multiple of env.room.cell_m={room.cell_m}, at least two"))
    if room.width_m * room.depth_m / room.cell_m**2 > MAX_CELLS:
        found.append(("env.room.cell_m", room.cell_m, f"a side with at most {MAX_CELLS} cells"))
    for key, position in (
        ("env.ap.position_m", config.ap.position_m),
        ("env.ris.position_m", config.ris.position_m),
    ):
        if not _numbers(position, 3) or not _inside(room, position, closed=True) or position[2] < 0:
            found.append((key, position, "[x, y, z] in m inside the room or on its edge"))
    for segment in config.walls.segments:
        if not _numbers(segment, 4) or segment[:2] == segment[2:]:
            found.append(("env.walls.segments", segment, "segments [x0, y0, x1, y1] in m"))
    starts = _fixed_start_problems if config.tasks.start == "fixed" else _start_problems
    return found or _destination_problems(config) or starts(config)


def _destination_problems(config: EnvConfig) -> list[Problem]:
    key = "env.tasks.destinations_m"
    room = config.room
    seen: set[tuple[int, ...]] = set()
    found: list[Problem] = []
    for destination in config.tasks.destinations_m:
        if not _numbers(destination, 2) or not _inside(room, destination):
            allowed = f"[x, y] inside the room of {room.width_m:g} m x {room.depth_m:g} m"
            found.append((key, destination, allowed))
            continue
        cell = _cell(room, destination)
        if cell in seen:
            found.append((key, destination, "destinations in cells of their own"))
        seen.add(cell)
    return found


def _start_problems(config: EnvConfig) -> list[Problem]:
    """Whether some cell is far enough from each destination; a drawn one may lie in the middle."""
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
    if tasks.start_distance_m <= reach:
        return []
    allowed = f"at most {reach:.4g}, since no cell is farther from one of the destinations"
    return [("env.tasks.start_distance_m", tasks.start_distance_m, allowed)]


def _given_destinations(config: EnvConfig) -> tuple[list[Any], int]:
    """The destinations that are given, and how many there are in all."""
    tasks = config.tasks
    number = 1 if tasks.destination == "common" else config.robots
    return ([] if tasks.destination == "random" else tasks.destinations_m[:number]), number


def _fixed_start_problems(config: EnvConfig) -> list[Problem]:
    key, room, starts = "env.tasks.starts_m", config.room, config.tasks.starts_m
    allowed = f"[x, y] inside the room of {room.width_m:g} m x {room.depth_m:g} m"
    found: list[Problem] = [
        (key, at, allowed) for at in starts if not _numbers(at, 2) or not _inside(room, at)
    ]
    if found:
        return found
    if len(starts) < config.robots:
        say = f"at least env.robots={config.robots} places with env.tasks.start=fixed"
        return [(key, starts, say)]
    goals, _ = _given_destinations(config)
    if config.tasks.destination == "common":
        goals = goals * config.robots
    return [
        (key, start, "places off the cell of the robot's destination")
        for start, goal in zip(starts, goals, strict=False)
        if _cell(room, start) == _cell(room, goal)
    ]


def _cell(room: RoomConfig, position: Sequence[float]) -> tuple[int, ...]:
    return tuple(math.floor(x / room.cell_m) for x in position)


def _numbers(value: Any, count: int) -> bool:
    return (
        isinstance(value, list)
        and len(value) == count
        and all(isinstance(x, int | float) and math.isfinite(x) for x in value)
    )


def _inside(room: RoomConfig, position: Sequence[float], *, closed: bool = False) -> bool:
    x, y = position[:2]
    if closed:
        return 0 <= x <= room.width_m and 0 <= y <= room.depth_m
    return 0 <= x < room.width_m and 0 <= y < room.depth_m


def _combination_problems(config: EnvConfig) -> list[Problem]:
    found: list[Problem] = []
    ris, power = config.ris, config.power
    if ris.side**2 % ris.subsurfaces:
        allowed = f"a divisor of the {ris.side**2} elements that env.ris.side={ris.side} gives"
        found.append(("env.ris.subsurfaces", ris.subsurfaces, allowed))
    elif ris.bits * ris.subsurfaces > MAX_PHASE_ACTIONS.bit_length() - 1:
        allowed = (
            f"at most {MAX_PHASE_ACTIONS} phase settings: with env.ris.bits={ris.bits}"
            f" that is {(MAX_PHASE_ACTIONS.bit_length() - 1) // ris.bits} sub-surfaces or fewer"
        )
        found.append(("env.ris.subsurfaces", ris.subsurfaces, allowed))
    projects = config.access == "noma" and power.resolve == "project"
    if projects and power.levels < config.robots:
        allowed = (
            f"at least env.robots={config.robots} with env.power.resolve=project, since NOMA gives"
            " each robot a level of its own (residual and zero allow fewer)"
        )
        found.append(("env.power.levels", power.levels, allowed))
    return found


def phase_actions(ris: RisConfig) -> int:
    """The number of the AP's actions: N_R^N phase settings, or the codebook's beams."""
    if ris.action == "codebook":
        return math.prod(ris.sectors)
    return int((2**ris.bits) ** ris.subsurfaces)


def _pair_problems(config: EnvConfig) -> list[Problem]:
    """Whether the distances from every element to every cell are too many to work out."""
    ris, room = config.ris, config.room
    cells = round(room.width_m / room.cell_m) * round(room.depth_m / room.cell_m)
    if ris.response not in ("far", "near") or ris.side**2 * cells <= MAX_PAIRS:
        return []
    allowed = (
        f"at most {math.isqrt(MAX_PAIRS // cells)} with env.ris.response={ris.response} and"
        f" {cells} cells, since elements times cells may be {MAX_PAIRS} at most"
    )
    return [("env.ris.side", ris.side, allowed)]


def _codebook_problems(config: EnvConfig) -> list[Problem]:
    """Whether beams can be made: from places of elements, for sectors that have cells."""
    ris, room, say = config.ris, config.room, "with env.ris.action=codebook"
    if ris.response not in ("far", "near"):
        allowed = f"far or near {say}, since a beam needs elements with places"
        return [("env.ris.response", ris.response, allowed)]
    if ris.subsurfaces != 1:
        allowed = f"1 {say}, which sets every element by itself"
        return [("env.ris.subsurfaces", ris.subsurfaces, allowed)]
    if ris.side == 0:
        return [("env.ris.side", ris.side, f"at least 1 {say}")]
    cells = [round(length / room.cell_m) for length in (room.width_m, room.depth_m)]
    shape = len(ris.sectors) == 2 and all(isinstance(number, int) for number in ris.sectors)
    if not shape or not all(1 <= n <= most for n, most in zip(ris.sectors, cells, strict=True)):
        allowed = f"[columns, rows] of 1 to {cells[0]} and 1 to {cells[1]}, the cells there are"
        return [("env.ris.sectors", ris.sectors, allowed)]
    if phase_actions(ris) > MAX_PHASE_ACTIONS:
        allowed = f"at most {MAX_PHASE_ACTIONS} sectors, each of which is an action of the AP"
        return [("env.ris.sectors", ris.sectors, allowed)]
    return []
