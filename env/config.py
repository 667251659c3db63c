"""The schema of the group ``env``: every physical constant and every switch of the model.

Values are the defaults of ``docs/assumptions.md``; "Table I" is the paper's table of parameters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Interval

MAX_PHASE_ACTIONS = 4096
MAX_CELLS = 250_000
MAX_ROBOTS = 64
MAX_PAIRS = 10**9  # of elements and cells whose distances the far and near field need

Positive = Annotated[float, Gt(0)]
NotNegative = Annotated[float, Ge(0)]
Side = Annotated[float, Interval(ge=1, le=1000)]


@dataclass(frozen=True)
class RoomConfig:
    """The floor: a rectangle with a corner at the origin, cut into square cells."""

    width_m: Side = 30.0
    depth_m: Side = 30.0
    cell_m: Annotated[Positive, "Delta_S, Table I"] = 0.5


@dataclass(frozen=True)
class WallsConfig:
    """Full-height walls, each ``[x0, y0, x1, y1]`` in m. They shade radio links.

    With ``block_motion`` they are solid: a move that touches or crosses one stays put.
    """

    segments: Annotated[list[Any], "x0, y0, x1, y1 in m"] = field(
        default_factory=lambda: [[0.0, 15.0, 21.0, 15.0]]
    )
    block_motion: Annotated[bool, "true: solid walls, which stop robots too"] = False


@dataclass(frozen=True)
class AccessPointConfig:
    """The access point."""

    position_m: list[float] = field(default_factory=lambda: [15.0, 30.0, 2.0])


@dataclass(frozen=True)
class RisConfig:
    """The reconfigurable intelligent surface: M = side^2 elements in N sub-surfaces."""

    position_m: list[float] = field(default_factory=lambda: [30.0, 7.5, 2.0])
    side: Annotated[int, Interval(ge=0, le=256), "M_R, so M = side^2; 0 is no RIS"] = 30
    subsurfaces: Annotated[int, Interval(ge=1, le=65536), "N"] = 1
    bits: Annotated[int, Interval(ge=1, le=12), "b, so N_R = 2^b phases"] = 2
    response: Annotated[str, Literal["coherent", "far", "near", "rayleigh"]] = "coherent"
    spacing: Annotated[
        float, Interval(ge=0.01, le=100), "of neighbouring elements, in wavelengths (far, near)"
    ] = 0.5
    axis: Annotated[str, Literal["x", "y"], "the panel's horizontal direction (far, near)"] = "y"
    action: Annotated[
        str, Literal["phases", "codebook"], "what the AP chooses; a codebook's beams (far, near)"
    ] = "phases"
    sectors: Annotated[list[int], "of the codebook, along x and y"] = field(
        default_factory=lambda: [6, 6]
    )


@dataclass(frozen=True)
class MotionConfig:
    """How robots move and what moving costs."""

    speed_mps: Annotated[Positive, "v, Table I"] = 0.5
    energy_per_m_j: Annotated[NotNegative, "E_1, Table I"] = 7.4
    idle_power_w: Annotated[Positive, "E_2, Table I"] = 0.29
    antenna_height_m: NotNegative = 1.0
    max_slots: Annotated[int, Interval(ge=1, le=1_000_000), "T_max = T_e"] = 150


@dataclass(frozen=True)
class TasksConfig:
    """Where robots start and where they are going.

    ``destination=fixed``: the first K of ``destinations_m``; where there are fewer, further ones
    are drawn, at least ``destination_spacing_m`` apart from all others. ``random``: all K are
    drawn so, once a run. ``common``: all robots go to the first one.

    ``start=random``: anywhere at least ``start_distance_m`` from the robot's destination, anew in
    each episode. ``fixed``: at the first K of ``starts_m``.
    """

    destination: Annotated[str, Literal["fixed", "random", "common"]] = "fixed"
    destinations_m: Annotated[list[Any], "of the first robots; further ones are drawn"] = field(
        default_factory=lambda: [[27.25, 12.25], [4.25, 10.25], [22.25, 2.25], [26.25, 24.25]]
    )
    destination_spacing_m: NotNegative = 5.0
    start: Annotated[str, Literal["random", "fixed"]] = "random"
    starts_m: Annotated[list[Any], "of at least all robots, with start=fixed"] = field(
        default_factory=list
    )
    start_distance_m: Annotated[NotNegative, "least distance from start to destination"] = 10.0


@dataclass(frozen=True)
class ChannelConfig:
    """Path loss and fading: 3GPP TR 38.901, indoor hotspot, or a user's model or file."""

    model: Annotated[
        str, "file (docs/channels.md), or an installed package's (docs/extending.md)"
    ] = "indoor_hotspot"
    file: Annotated[str | None, "the .npz file of channels, with model=file"] = None
    sha256: Annotated[str | None, "of that file; null takes it as it is when a run begins"] = None
    frequency_ghz: Positive = 2.4
    rician_k_db: float = 7.0
    fading: Annotated[str, Literal["static", "none", "slot"], "of the direct channel"] = "static"
    los_phase: Annotated[str, Literal["zero", "distance"]] = "zero"


@dataclass(frozen=True)
class NoiseConfig:
    """Thermal noise: sigma^2 = density times bandwidth."""

    density_dbm_per_hz: Annotated[float, "N_0"] = -100.0
    bandwidth_hz: Positive = 1.0


@dataclass(frozen=True)
class PowerConfig:
    """Downlink power: levels P_max / 2^l for l = 1..levels."""

    # Sums of up to 48 levels stay exact in float64.
    levels: Annotated[int, Interval(ge=1, le=48), "N_P"] = 6
    max_dbm: Annotated[float, Interval(ge=-60, le=60), "P_max"] = 20.0
    resolve: Annotated[str, Literal["project", "residual", "zero"]] = "project"
    sic_margin: Annotated[NotNegative, "rho_min in multiples of sigma^2"] = 10.0


@dataclass(frozen=True)
class OmaConfig:
    """Orthogonal access, Baseline 2: equal parts of band and power."""

    share: Annotated[
        str, Literal["fixed", "reallocate"], "parts of K, or of those still driving"
    ] = "fixed"


@dataclass(frozen=True)
class QoeConfig:
    """Quality of experience, Baseline 3: eta_k = C_1 lg(R_k) + C_2."""

    scale: Annotated[Positive, "C_1"] = 1.0
    offset: Annotated[float, "C_2"] = 0.0
    floor: Annotated[Positive, "least R_k in bit/s/Hz"] = 0.01


@dataclass(frozen=True)
class StateConfig:
    """What agents observe beyond the paper's position and direct channel."""

    destination: Annotated[str, Literal["offset", "none"], "none is the paper to the letter"] = (
        "offset"
    )
    way: Annotated[
        str,
        Literal["auto", "on", "off"],
        "a robot's moves that shorten its way, and the way left; auto: where walls are solid",
    ] = "auto"
    others: Annotated[
        int, Interval(ge=0, le=63), "of how many others at most the AP tells each robot"
    ] = 0
    weights: Annotated[
        bool, "the AP sees each robot's share of all w_k, what its rate counts for in (5a)"
    ] = False
    order: Annotated[
        str, Literal["index", "gain"], "of robots before the AP; gain: the strongest hbar first"
    ] = "index"


@dataclass(frozen=True)
class RewardConfig:
    """Weights of the robots' and the access point's rewards, and which reward robots get.

    A robot's weight w_k = (horizon / T_k)^2 is its rate's share of the objective (5a), with T_k the
    slots that it will have driven in all: those so far and the shortest way that is left.
    """

    model: Annotated[str, "the robots'; or an installed package's (docs/extending.md)"] = "paper"
    rate: Annotated[float, "phi"] = 0.05
    credit: Annotated[
        str,
        Literal["rate", "team", "difference"],
        "in the place of R_k: sum_j w_j R_j / w_k, or what of that is robot k's doing",
    ] = "rate"
    guidance: Annotated[float, "psi"] = 3.0
    guidance_discount: Annotated[
        float, Interval(gt=0, le=1), "kappa, of d^t; the robots' discount makes it a potential"
    ] = 1.0
    distance: Annotated[
        str,
        Literal["auto", "straight", "way"],
        "d; way is the shortest over the floor, auto that where walls are solid",
    ] = "auto"
    time: Annotated[float, "R_time, Table I"] = -1.0
    goal: Annotated[float, "R_goal, Table I"] = 100.0
    sum_rate: Annotated[float, "tau_1, Table I"] = 0.1
    weights: Annotated[
        str, Literal["equal", "objective"], "of the rates in the access point's reward, or w_k"
    ] = "equal"
    horizon_slots: Annotated[
        float, Interval(gt=0, le=1e6), "T_k of a robot with the weight 1, in w_k and in states"
    ] = 40.0
    global_offset: float = 0.0


@dataclass(frozen=True)
class EnvConfig:
    """The world of one run.

    ``plan`` names the floor plan that gave the geometry; a whole configuration holds its values,
    and nothing reads the plan again.
    """

    plan: Annotated[
        str,
        "default, corridor, hall, random:SEED, or the path of a TOML file (docs/floor_plans.md)",
    ] = "default"
    robots: Annotated[int, Interval(ge=1, le=MAX_ROBOTS), "K"] = 3
    map_seed: Annotated[int, Ge(0)] = 0
    collisions: Annotated[
        str, Literal["allow", "block"], "block: no robot enters a cell that another holds"
    ] = "allow"
    access: Annotated[str, Literal["noma", "oma"], "oma is Baseline 2"] = "noma"
    metric: Annotated[str, Literal["qos", "qoe"], "what rewards count; qoe is Baseline 3"] = "qos"
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


def phase_actions(ris: RisConfig) -> int:
    """The number of the AP's actions: N_R^N phase settings, or the codebook's beams."""
    if ris.action == "codebook":
        return math.prod(ris.sectors)
    return int((2**ris.bits) ** ris.subsurfaces)
