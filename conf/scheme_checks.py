"""What is allowed in the group ``scheme``: who decides, and with what else that goes."""

from __future__ import annotations

from collections.abc import Iterator

from agent.config import AgentConfig
from conf.networks import joint_actions
from conf.schema import Config, SchemeConfig
from env.validate import Problem

MOST_JOINT_ACTIONS = 100_000
"""A network's outputs for a centralized DQN: K = 3 with the paper's actions has 55,296."""


def rules(config: Config) -> Iterator[Problem]:
    """What is wrong with a scheme: keys, their values, and what is allowed.

    Args:
        config: free of other problems.
    """
    scheme = config.scheme
    found = list(_unread_keys(scheme))
    if not found and scheme.agents != "federated":
        found = list(_central_problems(config))
    if not found and scheme.robots != "learned":
        found = list(_idle_problems(config))
    yield from found


def _unread_keys(scheme: SchemeConfig) -> Iterator[Problem]:
    """Keys that are set where nothing reads them."""
    default, branching = SchemeConfig(), scheme.agents == "branching"
    if scheme.heads != default.heads and not branching:
        say = f"{default.heads} with scheme.agents={scheme.agents}: only branching reads it"
        yield "scheme.heads", scheme.heads, say
    whole = scheme.agents == "centralized" or (branching and scheme.heads == "shared")
    if scheme.global_share != default.global_share and not whole:
        say = (
            f"{default.global_share} here: only scheme.agents=centralized, and branching with"
            " scheme.heads=shared, read it"
        )
        yield "scheme.global_share", scheme.global_share, say


def _central_problems(config: Config) -> Iterator[Problem]:
    """One agent for everything: it has no federation, and leaves nothing for others to decide."""
    who = f"scheme.agents={config.scheme.agents}"
    if config.runtime.name != "local":
        say = f"local with {who}: one agent for everything has no federation"
        yield "runtime.name", config.runtime.name, say
    if config.strategy.name != "none":
        say = f"none with {who}: there is nothing to aggregate"
        yield "strategy.name", config.strategy.name, say
    for key in ("phase", "robots"):
        if getattr(config.scheme, key) != "learned":
            yield f"scheme.{key}", getattr(config.scheme, key), f"learned with {who}"
    if config.scheme.agents == "branching":
        yield from _head_problems(config.agent)
    count = joint_actions(config)
    if config.scheme.agents == "centralized" and count > MOST_JOINT_ACTIONS:
        yield (
            "env.robots",
            config.env.robots,
            f"fewer with {who}: the joint actions of all are {count:,}, and at most"
            f" {MOST_JOINT_ACTIONS:,} are taken (scheme.agents=branching has no such bound)",
        )


def _head_problems(agent: AgentConfig) -> Iterator[Problem]:
    """Ways of learning that a network with several heads does not have."""
    who = "with scheme.agents=branching: several heads have no such way of learning here"
    for key, value, off in (
        ("n_step", agent.n_step, 1),
        ("dueling", agent.dueling, False),
        ("priority.alpha", agent.priority.alpha, 0.0),
    ):
        if value != off:
            yield f"agent.{key}", value, f"{str(off).lower()} {who}"


def _idle_problems(config: Config) -> Iterator[Problem]:
    """Robots that drive shortest ways: nothing is learned, by them or by the access point."""
    scheme = config.scheme
    who = f"scheme.robots={scheme.robots}"
    if config.runtime.name != "local":
        say = f"local with {who}: robots that learn nothing have no federation"
        yield "runtime.name", config.runtime.name, say
    if scheme.phase == "learned":
        yield "scheme.phase", scheme.phase, f"random, fixed or oracle with {who}"
    elif scheme.robots == "shortest_best" and scheme.phase != "oracle":
        say = f"oracle with {who}: phases and powers are searched together"
        yield "scheme.phase", scheme.phase, say
