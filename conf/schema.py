"""The schema of a run: one frozen dataclass for each group of ``conf/``."""

from __future__ import annotations

from dataclasses import dataclass, field

from agent.config import AgentConfig
from env.config import EnvConfig


@dataclass(frozen=True)
class StrategyConfig:
    """How the robots' weights become one."""

    name: str = "fedavg"
    proximal_mu: float = 0.0  # mu, fedprox
    malicious: int = 0  # f, krum: how many robots may upload anything at all
    server_rate: float = 1.0  # eta, fedavgm and fedadam: how far the server steps
    momentum: float = 0.0  # beta, fedavgm
    beta_1: float = 0.0  # fedadam: decay of the mean of the robots' steps
    beta_2: float = 0.0  # fedadam: decay of the mean of their squares
    tau: float = 0.0  # fedadam: added to the root of those squares


@dataclass(frozen=True)
class SchemeConfig:
    """Who decides: the paper's F-DRL, or a baseline."""

    agents: str = "federated"  # or one agent for everything: centralized, branching
    phase: str = "learned"  # by the access point's DQN; or random, fixed, oracle
    robots: str = "learned"  # or shortest ways: shortest_canonical, shortest_best
    heads: str = "own"  # branching: each head's own reward, or shared
    global_share: float = 0.1  # of r_G in a reward for everything, Baseline 1


@dataclass(frozen=True)
class RuntimeConfig:
    """Where the agents run."""

    name: str = "local"
    start_timeout_s: float = 180.0  # until every Flower client has joined
    connection: str | None = None  # deployment: a SuperLink that Flower's configuration names
    secure: bool = False  # deployment: TLS and keys also on loopback


@dataclass(frozen=True)
class TrainConfig:
    """When a run ends: at the first window boundary after either limit."""

    episodes: int = 300  # N_e
    max_ticks: int | None = None


@dataclass(frozen=True)
class LinkConfig:
    """The lockstep link between the ServerApp and the robots."""

    host: str = "127.0.0.1"
    port: int = 0  # 0 picks a free one
    tls: bool | None = None  # None: where the host is not loopback
    timeout_s: float = 60.0  # longest wait for a robot's answer
    patience_s: float = 600.0  # longest silence of the server, while others join or it evaluates


@dataclass(frozen=True)
class FederationConfig:
    """How robots are dealt to Flower clients and how often weights are averaged."""

    every: int = 25  # N_F in ticks, Table I
    windows_per_round: int | None = None
    clients: int | None = None
    on_loss: str = "wait"  # for a robot that is lost to come back, or abort
    loss_timeout_s: float = 300.0  # how long to wait for it
    link: LinkConfig = field(default_factory=LinkConfig)


@dataclass(frozen=True)
class StateConfig:
    """Checkpoints, from which a run that died goes on."""

    every: int | None = 50  # windows between two; None writes none


@dataclass(frozen=True)
class EvaluationConfig:
    """Evaluation of frozen weights while training and at the end."""

    every: int = 10  # in training episodes
    episodes: int = 50
    epsilon: float = 0.05


@dataclass(frozen=True)
class RunConfig:
    """What a run leaves behind, and where."""

    dir: str | None = None
    id: str | None = None  # drawn when the run begins; names its robots' state on their nodes
    figures: bool = True
    tensorboard: bool = True


@dataclass(frozen=True)
class Config:
    """A whole run."""

    seed: int = 0
    env: EnvConfig = field(default_factory=EnvConfig)
    agent: AgentConfig = field(default_factory=AgentConfig)
    strategy: StrategyConfig = field(default_factory=StrategyConfig)
    scheme: SchemeConfig = field(default_factory=SchemeConfig)
    runtime: RuntimeConfig = field(default_factory=RuntimeConfig)
    train: TrainConfig = field(default_factory=TrainConfig)
    federation: FederationConfig = field(default_factory=FederationConfig)
    state: StateConfig = field(default_factory=StateConfig)
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    run: RunConfig = field(default_factory=RunConfig)


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
    """Flower clients that the robots are dealt to."""
    robots = config.env.robots
    default = robots if config.runtime.name == "deployment" else min(robots, DEFAULT_CLIENTS)
    return config.federation.clients or default


def waits_for_the_lost(config: Config) -> bool:
    """Whether the ServerApp itself waits for lost robots.

    Flower's simulation engine does not replace a client's process that has died, so there the
    launcher starts it anew.
    """
    return config.federation.on_loss == "wait" and config.runtime.name == "deployment"
