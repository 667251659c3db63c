"""The schema of the group ``env``: every physical constant and every switch of the model.

Values are the defaults of ``docs/assumptions.md``; "Table I" is the paper's table of parameters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
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
    """Full-height walls, each ``[x0, y0, x1, y1]`` in m. They shade radio links.

    With ``block_motion`` they are solid: a move that touches or crosses one stays put.
    """

    segments: list[Any] = field(default_factory=lambda: [[0.0, 15.0, 21.0, 15.0]])
    block_motion: bool = False


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
    """Path loss and fading: 3GPP TR 38.901, indoor hotspot, or a model of the user's own."""

    model: str = "indoor_hotspot"
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
    """Weights of the robots' and the access point's rewards, and which reward robots get."""

    model: str = "paper"
    rate: float = 0.05  # phi
    guidance: float = 3.0  # psi
    distance: str = "straight"  # d: straight, or way over the floor
    time: float = -1.0  # R_time, Table I
    goal: float = 100.0  # R_goal, Table I
    sum_rate: float = 0.1  # tau_1, Table I
    global_offset: float = 0.0


@dataclass(frozen=True)
class EnvConfig:
    """The world of one run.

    ``plan`` names the floor plan that gave the geometry; a whole configuration holds its values,
    and nothing reads the plan again.
    """

    plan: str = "default"
    robots: int = 3  # K
    map_seed: int = 0
    collisions: str = "allow"
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
    "env.collisions": ("allow", "block"),
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
    "env.reward.distance": ("straight", "way"),
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


def phase_actions(ris: RisConfig) -> int:
    """The number of the AP's actions: N_R^N phase settings, or the codebook's beams."""
    if ris.action == "codebook":
        return math.prod(ris.sectors)
    return int((2**ris.bits) ** ris.subsurfaces)
