"""The schema of a run: one frozen dataclass for each group of ``conf/``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, Literal

from annotated_types import Ge, Interval

from agent.config import AgentConfig
from conf.exchange_schema import (
    AirtimeConfig,
    AttackConfig,
    CompressionConfig,
    LossesConfig,
    PrivacyConfig,
)
from env.config import MAX_ROBOTS, EnvConfig, NotNegative

Decay = Annotated[float, Interval(ge=0, lt=1)]
Seconds = Annotated[float, Interval(ge=0.1, le=86_400)]


@dataclass(frozen=True)
class StrategyConfig:
    """How the robots' weights become one."""

    name: str = "fedavg"
    proximal_mu: Annotated[NotNegative, "mu, fedprox"] = 0.0
    malicious: Annotated[
        int, Ge(0), "f, krum, multikrum, bulyan: how many robots may upload anything at all"
    ] = 0
    selected: Annotated[int, Ge(1), "m, multikrum: how many uploads are averaged"] = 1
    trim: Annotated[
        float, Interval(ge=0, lt=0.5), "beta, fedtrimmedavg: share cut off at either end"
    ] = 0.0
    server_rate: Annotated[
        float, Interval(gt=0, le=10), "eta, fedavgm and fedadam: how far the server steps"
    ] = 1.0
    momentum: Annotated[Decay, "beta, fedavgm"] = 0.0
    beta_1: Annotated[Decay, "fedadam: decay of the mean of the robots' steps"] = 0.0
    beta_2: Annotated[Decay, "fedadam: decay of the mean of their squares"] = 0.0
    tau: Annotated[NotNegative, "fedadam: added to the root of those squares"] = 0.0
    target: Annotated[
        str | None, "own: an installed strategy's name, or package:Class (docs/extending.md)"
    ] = None
    options: Annotated[Any, "own: a mapping, what its class is made with"] = None
    scope: Annotated[
        str,
        Literal["pair", "online"],
        "own: what it is applied to, online and target networks or the online ones",
    ] = "pair"
    dp: PrivacyConfig = field(default_factory=PrivacyConfig)
    graph: Annotated[
        str, Literal["ring", "complete", "random"], "gossip: who hears whom; random: drawn anew"
    ] = "ring"
    degree: Annotated[
        int, Interval(ge=1, le=MAX_ROBOTS), "gossip on a random graph: whom each robot picks"
    ] = 1


@dataclass(frozen=True)
class SchemeConfig:
    """Who decides: the paper's F-DRL, or a baseline."""

    agents: Annotated[
        str, Literal["federated", "centralized", "branching"], "the last two: one for everything"
    ] = "federated"
    phase: Annotated[
        str, Literal["learned", "random", "fixed", "oracle"], "learned by the access point's DQN"
    ] = "learned"
    robots: Annotated[
        str,
        Literal["learned", "shortest_canonical", "shortest_best"],
        "the last two: shortest ways",
    ] = "learned"
    power: Annotated[
        str,
        Literal["robots", "ap", "search"],
        "who picks powers: each robot its own, the access point's DQN, or a search in each slot",
    ] = "robots"
    heads: Annotated[str, Literal["own", "shared"], "branching: whose reward"] = "own"
    global_share: Annotated[NotNegative, "of r_G in a reward for everything (Baseline 1)"] = 0.1


@dataclass(frozen=True)
class RuntimeConfig:
    """Where the agents run."""

    name: Annotated[str, Literal["local", "simulation", "deployment"]] = "local"
    start_timeout_s: Annotated[Seconds, "until every Flower client has joined"] = 180.0
    connection: Annotated[
        str | None, "deployment: a SuperLink that Flower's configuration names; null starts one"
    ] = None
    secure: Annotated[bool, "deployment: TLS and keys also on loopback"] = False


@dataclass(frozen=True)
class TrainConfig:
    """When a run ends: at the first window boundary after either limit."""

    episodes: Annotated[int, Ge(1), "N_e"] = 300
    max_ticks: Annotated[int | None, Ge(1), "a number ends the run earlier"] = None
    worlds: Annotated[
        int, Interval(ge=1, le=1000), "E: copies of the world in which each robot drives at once"
    ] = 1


@dataclass(frozen=True)
class LinkConfig:
    """The lockstep link between the ServerApp and the robots."""

    host: str = "127.0.0.1"
    port: Annotated[int, Interval(ge=0, le=65_535), "0 picks a free one"] = 0
    tls: Annotated[bool | None, "null is true where the host is not loopback"] = None
    timeout_s: Annotated[Seconds, "longest wait for a robot's answer"] = 60.0
    patience_s: Annotated[
        Seconds, "longest silence of the server, while others join or it evaluates"
    ] = 600.0


@dataclass(frozen=True)
class FederationConfig:
    """How robots are dealt to Flower clients and how often weights are averaged."""

    every: Annotated[
        int, Interval(ge=1, le=1_000_000), "N_F: ticks between aggregations, Table I"
    ] = 25
    windows_per_round: Annotated[
        int | None, Ge(1), "aggregations in one Flower round; null is 100, deployed 20 000 ticks'"
    ] = None
    clients: Annotated[int | None, "Flower clients; null is min(K, 4), deployed K"] = None
    on_loss: Annotated[
        str,
        Literal["wait", "abort", "miss"],
        "wait for a robot or process that is lost to come back; miss: its rooms miss the round",
    ] = "wait"
    loss_timeout_s: Annotated[Seconds, "how long to wait for it"] = 300.0
    hear: Annotated[
        int | None, Ge(1), "robots with the best channels that are averaged; null is all"
    ] = None
    own: Annotated[
        str,
        Literal["none", "heads", "trunk", "input", "normalisation"],
        "what stays each robot's own: the last layer, all but it, the first, its scale of inputs",
    ] = "none"
    compression: CompressionConfig = field(default_factory=CompressionConfig)
    airtime: AirtimeConfig = field(default_factory=AirtimeConfig)
    fraction: Annotated[
        float, Interval(gt=0, le=1), "C: share of the robots asked to upload, drawn each window"
    ] = 1.0
    losses: LossesConfig = field(default_factory=LossesConfig)
    link: LinkConfig = field(default_factory=LinkConfig)


@dataclass(frozen=True)
class RoomsConfig:
    """A building of rooms, each a world with an access point, a surface and robots of its own.

    What differs from room to room is dealt in turn: room r has the plan ``plans[r % len(plans)]``
    and so on. Its seed, which draws its radio map, starts and destinations, comes from the run's.
    """

    count: Annotated[
        int, Interval(ge=1, le=10_000), "R; 1 with nothing held out is the one room of env"
    ] = 1
    plans: Annotated[
        list[Any], "floor plans; random is a floor of its own for each room, [] is env.plan"
    ] = field(default_factory=list)
    robots: Annotated[list[int], "K; [] is env.robots"] = field(default_factory=list)
    every: Annotated[int, Interval(ge=1, le=1_000_000), "windows between averages of rooms"] = 4
    access_points: Annotated[
        str, Literal["own", "mean"], "their networks: each its own, or averaged as the robots' are"
    ] = "own"
    fraction: Annotated[
        float, Interval(gt=0, le=1), "of the rooms that take part in a round, drawn anew"
    ] = 1.0
    held_out: Annotated[
        int, Interval(ge=0, le=10_000), "rooms that nobody trains in, to evaluate in"
    ] = 0
    evaluated: Annotated[
        int, Interval(ge=1, le=10_000), "rooms of each kind at most that an evaluation plays in"
    ] = 16
    strategy: StrategyConfig = field(default_factory=StrategyConfig)


@dataclass(frozen=True)
class CheckpointConfig:
    """Checkpoints, from which a run that died goes on."""

    every: Annotated[int | None, Ge(1), "windows between checkpoints; null writes none"] = 50


@dataclass(frozen=True)
class EvaluationConfig:
    """Evaluation of frozen weights while training and at the end."""

    every: Annotated[int, Ge(1), "training episodes between evaluations"] = 10
    episodes: Annotated[int, Interval(ge=1, le=100_000)] = 50
    epsilon: Annotated[float, Interval(ge=0, le=1)] = 0.05


@dataclass(frozen=True)
class RunConfig:
    """What a run leaves behind, and where."""

    dir: Annotated[str | None, "null makes a new folder below runs/"] = None
    id: Annotated[str | None, "null draws one; it names the robots' state on their nodes"] = None
    figures: bool = True
    tensorboard: Annotated[bool, "a tracker, as the next two; any of them together"] = True
    wandb: Annotated[bool, "offline, into the run's folder, unless WANDB_MODE says otherwise"] = (
        False
    )
    mlflow: Annotated[bool, "into the run's folder, unless MLFLOW_TRACKING_URI says otherwise"] = (
        False
    )


@dataclass(frozen=True)
class Config:
    """A whole run."""

    seed: Annotated[int, Ge(0)] = 0
    env: EnvConfig = field(default_factory=EnvConfig)
    agent: AgentConfig = field(default_factory=AgentConfig)
    strategy: StrategyConfig = field(default_factory=StrategyConfig)
    attack: AttackConfig = field(default_factory=AttackConfig)
    scheme: SchemeConfig = field(default_factory=SchemeConfig)
    runtime: RuntimeConfig = field(default_factory=RuntimeConfig)
    train: TrainConfig = field(default_factory=TrainConfig)
    federation: FederationConfig = field(default_factory=FederationConfig)
    rooms: RoomsConfig = field(default_factory=RoomsConfig)
    state: CheckpointConfig = field(default_factory=CheckpointConfig)
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    run: RunConfig = field(default_factory=RunConfig)


def changed(group: Any) -> Iterator[tuple[str, Any, Any]]:
    """The fields of a group that are not at their defaults: name, value, default."""
    usual = type(group)()
    for item in fields(group):
        value, default = getattr(group, item.name), getattr(usual, item.name)
        if value != default:
            yield item.name, value, default


DEFAULT_WINDOWS_PER_ROUND = 100
DEFAULT_CLIENTS = 4
DEPLOYED_ROUND_TICKS = 20_000
"""A Flower round of a deployment by default: an exchange of messages costs 10 to 30 s there."""


def windows_per_round(config: Config) -> int:
    """Windows that one Flower train message covers."""
    default = DEFAULT_WINDOWS_PER_ROUND
    if config.runtime.name == "deployment":
        default = max(1, DEPLOYED_ROUND_TICKS // config.federation.every)
    return config.federation.windows_per_round or default


def flower_clients(config: Config) -> int:
    """Flower clients that the robots, or in a building the rooms, are dealt to."""
    if has_rooms(config):
        return config.federation.clients or min(config.rooms.count, DEFAULT_CLIENTS)
    robots = config.env.robots
    default = robots if config.runtime.name == "deployment" else min(robots, DEFAULT_CLIENTS)
    return config.federation.clients or default


def has_rooms(config: Config) -> bool:
    """Whether a run is of a building, and not of the one room that ``env`` describes."""
    return config.rooms.count > 1 or config.rooms.held_out > 0


def taking_part(config: Config) -> int:
    """Rooms that take part in a round of a building."""
    return max(1, round(config.rooms.fraction * config.rooms.count))


def waits_for_the_lost(config: Config) -> bool:
    """Whether the ServerApp itself waits for lost robots.

    Flower's simulation engine does not replace a client's process that has died, so there the
    launcher starts it anew.
    """
    return config.federation.on_loss == "wait" and config.runtime.name == "deployment"
